"""What every learner produces and every planner consumes: one or many models under one protocol."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.cautions import together
from models.errors import InputError, Phrase, located
from models.lspomdp import LatentStatePOMDP, check_rows, default_state_names
from models.model_files import model_from_dict
from models.notebook_view import NotebookView, View, frame_rows
from models.protocol import Protocol
from models.reward import Reward, default_x
from models.text_files import LARGEST_NUMBER

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ModelDraws(NotebookView):
    """Weighted draws of a latent-state model: a point estimate is one draw, a posterior is many.

    Attributes
    ----------
    protocol : Protocol
    initial : float64[d, s]
    transition : float64[d, a, s, s']
    emission : float64[d, e, s, o]
    weight : float64[d]
        Non-negative, summing to one.
    provenance : mapping
        Where the draws come from: data, model, seed, versions.
    state_names : tuple of str
        Names shared by all draws; the defaults for this number of states unless given.
    reward : Reward, optional
        Reward shared by all draws; the published one unless given.
    cautions : tuple of str
        Why not to trust them, such as a posterior that failed its convergence gate. Everything made from the draws
        repeats them (`models.cautions`).
    """

    protocol: Protocol
    initial: Array
    transition: Array
    emission: Array
    weight: Array
    provenance: Mapping[str, Any] = field(default_factory=dict)
    state_names: tuple[str, ...] = ()
    reward: Reward | None = None
    cautions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        d, s = self.initial.shape if self.initial.ndim == 2 else (0, 0)
        if d == 0 or s == 0:
            raise located("model draws, initial", self.initial.shape, "shape [draw, state]")
        p = self.protocol
        for name, shape in (
            ("transition", (d, p.n_actions, s, s)),
            ("emission", (d, len(p.emission_actions), s, p.n_responses)),
            ("weight", (d,)),
        ):
            if getattr(self, name).shape != shape:
                raise located(f"model draws, shape of {name}", getattr(self, name).shape, str(shape))
        if np.any(~(self.weight >= 0)) or abs(self.weight.sum() - 1) > 1e-9:
            wanted = "non-negative weights that sum to 1 (key weight of every model; divide each by the sum)"
            raise located("model draws, sum of weights", round(float(self.weight.sum()), 10), wanted)
        for name in ("initial", "transition", "emission"):
            table = getattr(self, name)
            rows = table.reshape(-1, table.shape[-1])
            per_draw = len(rows) // d
            check_rows(name, rows, _RowNames(per_draw))

    @property
    def n_draws(self) -> int:
        """Number of draws."""
        return len(self.weight)

    @property
    def n_states(self) -> int:
        """Number of latent states."""
        return self.initial.shape[1]

    @classmethod
    def from_models(
        cls,
        models: Sequence[LatentStatePOMDP],
        weight: Array | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> ModelDraws:
        """Stack models of the same size and protocol; equal weights unless given."""
        if not models:
            raise located("model draws", 0, "at least one model")
        for i, model in enumerate(models):
            if model.protocol != models[0].protocol or model.n_states != models[0].n_states:
                found = Phrase(f"{model.n_states} states, protocol {model.protocol.name!r}")
                wanted = f"{models[0].n_states} states, protocol {models[0].protocol.name!r}, as draw 0"
                raise located(f"model draws, draw {i}", found, wanted)
            if model.reward != models[0].reward or model.state_names != models[0].state_names:
                raise InputError(
                    f"model draws, draw {i}: its reward or state names differ from those of draw 0; draws of one "
                    "posterior share both"
                )
        n = len(models)
        return cls(
            models[0].protocol,
            np.stack([m.initial for m in models]),
            np.stack([m.transition for m in models]),
            np.stack([m.emission for m in models]),
            np.full(n, 1.0 / n) if weight is None else np.asarray(weight, dtype=np.float64),
            dict(provenance or {}),
            models[0].state_names,
            models[0].reward,
            together(*(m.cautions for m in models)),
        )

    @classmethod
    def from_json(cls, content: Any, place: str = "models", protocol: Protocol | None = None) -> ModelDraws:
        """One model object, or a list of them, each with an optional `weight` (all or none of them)."""
        entries = content if isinstance(content, list) else [content]
        if not entries:
            raise located(place, Phrase("an empty list"), "at least one model object")
        models = [model_from_dict(e, f"{place}, model {i}", protocol) for i, e in enumerate(entries)]
        given = ["weight" in e for e in entries]
        if any(given) and not all(given):
            raise InputError(f"{place}: model {given.index(False)} has no weight although others have one")
        weight = None
        if all(given):
            for i, value in enumerate(e["weight"] for e in entries):
                number = isinstance(value, int | float) and not isinstance(value, bool)
                if not (number and 0 <= value < LARGEST_NUMBER):
                    raise located(f"{place}, model {i}, weight", value, "a number of at least 0")
            weight = np.array([e["weight"] for e in entries], dtype=np.float64)
        return cls.from_models(models, weight, {"source": place})

    def model(self, draw: int) -> LatentStatePOMDP:
        """One draw as a model."""
        return LatentStatePOMDP(
            self.initial[draw], self.transition[draw], self.emission[draw], self.protocol,
            self.state_names or default_state_names(self.n_states),
            self.reward or Reward(default_x(self.n_states)), self.cautions,
        )  # fmt: skip

    def __iter__(self) -> Iterator[LatentStatePOMDP]:
        return (self.model(i) for i in range(self.n_draws))

    def __len__(self) -> int:
        return self.n_draws

    def some(self, keep: NDArray[np.int64] | slice) -> ModelDraws:
        """Some of the draws, weights renormalised."""
        weight = self.weight[keep]
        return replace(
            self, initial=self.initial[keep], transition=self.transition[keep], emission=self.emission[keep],
            weight=weight / weight.sum(),
        )  # fmt: skip

    def thin(self, n: int) -> ModelDraws:
        """`n` evenly spaced draws (all of them if there are fewer), weights renormalised."""
        if n < 1:
            raise located("thin, n", n, "at least 1")
        if n >= self.n_draws:
            return self
        keep = np.floor((np.arange(n) + 0.5) * self.n_draws / n).astype(int)
        return self.some(keep)

    def _view(self) -> View:
        n, states = len(self.weight), self.initial.shape[1]
        about = "; ".join(
            f"{key} {value}" for key, value in self.provenance.items() if isinstance(value, str | int)
        )
        told = f"{n:,} draw{'s' * (n != 1)} of a model with {states} states under protocol {self.protocol.name}."
        mean = self.weight @ self.initial
        rows = [
            {"state": name, "initial, mean": float(mean[i])} for i, name in enumerate(self.model(0).state_names)
        ]
        return View("Draws of a model", "", (), (about,) if about else (), (told,), (frame_rows(rows),))


class _RowNames(Sequence[tuple[str, ...]]):
    """Names of flattened rows, made only when an error needs one."""

    def __init__(self, per_draw: int) -> None:
        self.per_draw = per_draw

    def __getitem__(self, index: Any) -> Any:
        return (f"draw {index // self.per_draw}", f"row {index % self.per_draw}")

    def __len__(self) -> int:  # pragma: no cover - required by Sequence
        return 0
