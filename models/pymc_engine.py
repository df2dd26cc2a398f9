"""The PyMC model as something to sample: chain by chain with nutpie, all at once with PyMC's own sampler."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pymc as pm
import xarray as xr
from numpy.typing import NDArray
from pymc.model.transform.optimization import freeze_dims_and_data
from pytensor.compile.mode import Mode

from models.bayesian_hmm import learned_names, learned_vector, model_of
from models.chains import STATS, Chain, NutsSettings
from models.parameters import Array
from models.study_density import StudyDensity

STREAM = 7_110
"""First element of the spawn keys of chains: not the direct engine's, so that the two engines check each other."""

INTERPRETED = Mode(linker="py", optimizer="fast_compile")
"""A few evaluations are not worth compiling for."""

PYMC_STATS = {
    "diverging": "diverging", "n_steps": "n_steps", "depth": "tree_depth", "energy": "energy", "lp": "lp",
    **{name: name for name in ("reached_max_treedepth", "step_size", "acceptance_rate")},
}  # fmt: skip
"""Our names of the sampler's statistics and those of PyMC's own sampler."""


@dataclass(frozen=True, eq=False)
class ModelTarget:
    """A PyMC model of a study; draws are vectors of learned entries.

    Attributes
    ----------
    study : StudyDensity
    model : pymc.Model
        `models.bayesian_hmm.model_of` the study, or what an analyst made of it: the same names for the same tables.
    """

    study: StudyDensity
    model: pm.Model

    stream = STREAM

    @classmethod
    def of(cls, study: StudyDensity) -> ModelTarget:
        """The model with the study's own priors."""
        model = model_of(study)
        model.check_bounds = False  # no parameter can leave its range: less to compile
        return cls(study, model)

    @cached_property
    def frozen(self) -> pm.Model:
        """Shapes and data as constants: less to compile."""
        return freeze_dims_and_data(self.model)

    def prepare(self) -> None:
        """Compile: seconds, whatever the size of the study."""
        self.nutpie_model()

    def nutpie_model(self) -> Any:
        """Compiled once, shared by all chains."""
        return self._compiled

    @cached_property
    def _compiled(self) -> Any:
        import nutpie

        compiled = nutpie.compile_pymc_model(self.frozen, var_names=self.sampled_names)
        return replace(compiled, initial_point_func=self.starts(compiled))

    def starts(self, compiled: Any) -> Callable[[int], Array]:
        """Where chains start, by seed."""
        return _starts(self.study, compiled.shape_info, compiled.initial_point_func)

    def columns(self, posterior: xr.Dataset) -> Array:
        """Learned entries, sigma last where people differ."""
        return self.joined(posterior)[0]

    def joined(self, draws: xr.Dataset) -> Array:
        """Draws as vectors ``[chain, draw, column]``."""
        return self.vectors(draws)

    def vectors(self, draws: xr.Dataset) -> Array:
        """Learned vectors ``[chain, draw, p]``, sigma last where people differ."""
        return learned_vector(self.study, self.filled(draws))

    @cached_property
    def sampled_names(self) -> list[str]:
        """The tables that vary; `pymc.do` makes constants of others."""
        return learned_columns(self)

    def filled(self, draws: xr.Dataset) -> xr.Dataset:
        """Draws with the tables that the model holds."""
        lead = (draws.sizes["chain"], draws.sizes["draw"])
        held = {}
        for name in learned_names(self.study):
            if name not in draws:
                value = np.asarray(self.model[name].eval(mode=INTERPRETED))
                own = [f"{name}_{i}" for i in range(value.ndim)]
                held[name] = (("chain", "draw", *own), np.broadcast_to(value, (*lead, *value.shape)))
        return draws.assign(held)


def learned_columns(target: ModelTarget) -> list[str]:
    """Variables with what is learned that vary in a model."""
    varying = {v.name for v in [*target.model.free_RVs, *target.model.deterministics]}
    return [name for name in learned_names(target.study) if name in varying]


def _starts(
    study: StudyDensity, shape_info: tuple[list[str], list[slice], list[tuple[int, ...]]],
    by_pymc: Callable[[int], Array],
) -> Callable[[int], Array]:  # fmt: skip
    """Where chains start: as with the direct engine, wherever the model has the variables it would have by itself.

    Its coordinates are those of the density, variable by variable; PyMC knows where to start what was added.
    """
    built = model_of(study)
    own = [built.rvs_to_values[v].name for v in built.free_RVs]
    place = dict(zip(shape_info[0], shape_info[1], strict=True))
    if any(name not in place for name in own):
        return by_pymc
    index = np.concatenate([np.arange(place[name].start, place[name].stop) for name in own])
    if len(index) != study.density.dimension:
        return by_pymc

    def start(seed: int) -> Array:
        x = by_pymc(seed)
        x[index] = study.density.starting_point(seed)
        return x

    return start


def sampled_by_pymc(target: ModelTarget, settings: NutsSettings) -> dict[int, Chain]:
    """All chains by PyMC's own sampler, where nutpie is not installed: much slower, and nothing is kept meanwhile.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C, which PyMC itself answers with the draws it has.
    """
    with target.frozen:
        trace = pm.sample(
            settings.draws, tune=settings.tune, chains=settings.chains, random_seed=settings.seed,
            nuts_sampler="pymc", progressbar=False, nuts={"target_accept": settings.target_accept},
            compute_convergence_checks=False, var_names=target.sampled_names,
        )  # fmt: skip
    x = target.joined(trace["posterior"].to_dataset())
    if x.shape[:2] != (settings.chains, settings.draws):
        raise KeyboardInterrupt("nothing of PyMC's own sampler is kept: the run starts anew")
    return {c: Chain(x[c], stats) for c, stats in enumerate(statistics_of(trace, settings.chains))}


def statistics_of(trace: xr.DataTree, chains: int) -> list[dict[str, NDArray]]:
    """Statistics of the sampler, chain by chain, whichever of nutpie and PyMC made the trace."""
    if "sample_stats" not in trace.children:
        return [{} for _ in range(chains)]
    own = trace["sample_stats"].to_dataset()
    found = {}
    for ours, theirs in PYMC_STATS.items():
        name = next((n for n in (theirs, STATS[ours], ours) if n in own), None)
        if name is not None:
            found[ours] = own[name].transpose("chain", "draw").to_numpy()
    return [{name: values[c] for name, values in found.items()} for c in range(chains)]
