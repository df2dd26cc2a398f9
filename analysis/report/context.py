"""What every section is given: the data, the fits, and how both were asked for."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

from analysis.datasets import DataSet, log_digest
from analysis.em_study import EmStudy, Progress
from analysis.fits import StoredFit, stored_fit
from analysis.report.effort import Effort
from analysis.report.section import Origin
from analysis.stated_reward import StatedReward
from analysis.stored_results import found_or_made, stored_result
from analysis.study_selection import Selection
from models.events import EventLog
from models.parameters import STICKY, DirichletPrior
from models.posterior import Posterior
from models.protocol import PUBLISHED, Protocol

PACKAGES = (
    "prosocial-workbench", "numpy", "scipy", "pandas", "numba", "nutpie", "arviz", "xarray", "matplotlib", "jinja2",
)  # fmt: skip


@dataclass(frozen=True)
class ReportContext:
    """Everything a section may use.

    Attributes
    ----------
    selection : Selection
        The data set, the part of it the report is about, and what is held fixed.
    study : EmStudy
        Fits of that part.
    seed : int
    effort : Effort
        How much work went into the fits; `effort.quick` reports are not for citation.
    published : mapping
        Numbers printed in the paper (`analysis.design.published`).
    command : str
        Command line, as given.
    date : str
    progress : callable, optional
        Called with (what is running, done, total).
    stated : StatedReward, optional
        What a round is worth, where it was said for this report; else the printed reward, for the paper's protocol.
    found : dict of str to bool
        What costs more than a second, in words, and whether it was found in the store rather than computed.
    """

    selection: Selection
    study: EmStudy
    seed: int
    effort: Effort
    published: Mapping[str, Any]
    command: str
    date: str
    progress: Progress | None = None
    stated: StatedReward | None = None
    found: dict[str, bool] = field(default_factory=dict, repr=False, compare=False)
    _posteriors: dict[tuple[int, float], Posterior] = field(default_factory=dict, repr=False, compare=False)

    def posterior(self, states: int, kappa: float = STICKY.stay) -> Posterior:
        """Posterior at a number of states and stickiness: sampled when first asked for, or found in the store.

        The refits at other values of kappa have their own, smaller effort.
        """
        key = (states, kappa)
        if key not in self._posteriors:
            label, stored = posterior_of(self.selection, states, kappa, self.effort, self.seed, self.progress)
            self.found[label] = stored.reused
            self._posteriors[key] = stored.posterior
        return self._posteriors[key]

    def kept[**P, R](self, what: str, function: Callable[P, R], *args: P.args, **keywords: P.kwargs) -> R:
        """What a function returns, found in the store or computed and kept (`analysis.stored_results`).

        Parameters
        ----------
        what : str
            The result in words, unlike any other of the report.
        function : callable
        *args, **keywords
            Its arguments.
        """
        stored = stored_result(what, function, *args, **keywords)
        self.found.setdefault(what, stored.reused)  # a part that asks again finds what this report computed
        return stored.value

    def kept_from[R](
        self, what: str, make: Callable[[], R], function: Callable[..., Any], given: Mapping[str, Any],
        modules: Iterable[str] = (),
    ) -> R:  # fmt: skip
        """The same, of a function that takes functions: `given` is everything that determines the result.

        Parameters
        ----------
        what : str
        make, function, given, modules
            As in `analysis.stored_results.found_or_made`.
        """
        stored = found_or_made(what, make, function, given, modules=modules)
        self.found.setdefault(what, stored.reused)  # a part that asks again finds what this report computed
        return stored.value

    @property
    def data(self) -> DataSet:
        """The data set as loaded, with its card."""
        return self.selection.dataset

    @property
    def log(self) -> EventLog:
        """The part of the data that the report is about."""
        return self.selection.log

    @property
    def conditions(self) -> tuple[str, ...]:
        """Conditions selected; empty for all."""
        some = len(self.selection.conditions) < len(self.data.log.conditions)
        return self.selection.conditions if some else ()

    @property
    def pins(self) -> tuple[str, ...]:
        """Actions whose transition table is fixed to the identity."""
        return self.selection.pins

    @property
    def origin(self) -> Origin:
        """Origin of everything computed from the data set."""
        return Origin.of_kind(self.data.card.kind)

    @property
    def protocol(self) -> Protocol:
        """Protocol of the log."""
        return self.log.protocol

    @property
    def is_published_protocol(self) -> bool:
        """Whether the actions and responses are the paper's."""
        return self.protocol == PUBLISHED

    @property
    def is_published_schedule(self) -> bool:
        """Whether people of the paper's conditions went through its orders of rounds, however many they are.

        What was simulated for that design then tells of this one.
        """
        printed = self.published["study1"]
        return (
            self.is_published_protocol
            and set(self.log.conditions) == set(printed["conditions"])
            and set(self.log.schedules()) <= set(printed["sequences"])
        )

    @property
    def is_published_design(self) -> bool:
        """Whether there are as many people as in the paper's study 1 too, so that its numbers can stand beside."""
        return self.is_published_schedule and self.log.n_participants == self.published["study1"]["participants"]

    @property
    def shown_states(self) -> tuple[int, ...]:
        """Numbers of states whose model is shown in full: four, as published, and the choice of BIC."""
        wanted = {4, self.study.best_by_bic}
        return tuple(k for k in self.study.states if k in wanted)


def posterior_of(
    chosen: Selection, states: int, kappa: float, effort: Effort, seed: int, progress: Progress | None = None
) -> tuple[str, StoredFit]:
    """The posterior of a report at a number of states and stickiness, in words and sampled, or from the store."""
    label = f"posterior, {states} state{'s' * (states != 1)}, kappa {kappa:g}"
    stored = stored_fit(
        chosen.log, log_digest(chosen.log), states, prior=DirichletPrior(stay=kappa),
        pins=dict.fromkeys(chosen.pins), sampler=effort.sampler(seed, kappa == STICKY.stay),
        progress=None if progress is None else lambda _, done, total: progress(label, done, total),
    )  # fmt: skip
    return label, stored


def versions() -> dict[str, str]:
    """Versions of Python and of the packages the numbers depend on."""
    out = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            out[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            out[name] = "not installed as a package"
    return out
