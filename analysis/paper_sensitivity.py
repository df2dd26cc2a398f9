"""The paper's sensitivity analysis in numbers: its grid, its findings in the truth and in the point estimate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from analysis.figures.sensitivity import READING_LABELS
from analysis.paper_agreement import counted, readings, unchecked
from analysis.paper_numbers import Basis, Check, Ours, PaperNumber
from analysis.sensitivity import SensitivityEffort, SensitivityStudy, sensitivity_study
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.sensitivity.reward_grid import PRINTED_COSTS, PRINTED_R, GridDecisions
from models.unseen import evidence_of_actions, unseen_actions

TOPIC = "Sensitivity analysis"
PLACE, FIGURE = "Sec. V-B", "Fig. 5"
SECTION = "sensitivity"

CLAIMS = {"helping": 8, "signalling": 9, "contrast": 10}
"""Places of the findings among the printed claims."""

EFFORT = SensitivityEffort(critical=False, variants=False)
"""Grid and findings only, as the section on sensitivity has it for one model."""

HALF = 0.5
HOLDS = {"holds": True, "holds in part": False, "does not hold": False}

Array = NDArray[np.float64]
Rule = Callable[[GridDecisions], tuple[bool, str]]


def sensitivity_numbers(ours: Ours) -> list[PaperNumber]:
    """Rows on the grid, the findings, and what else the text says of them."""
    printed = ours.published["sensitivity"]
    grids = {"r": ("values of r", PRINTED_R), "cost_help": ("costs of helping", PRINTED_COSTS),
             "cost_signal": ("costs of signalling", PRINTED_COSTS)}  # fmt: skip
    rows = []
    for key, (name, own) in grids.items():
        same = counted([float(v) for v in printed[key]], [float(v) for v in own], taken_over=True)
        told = ", ".join(f"{v:g}" for v in own)
        rows.append(
            PaperNumber(TOPIC, PLACE, name, ", ".join(f"{v:g}" for v in printed[key]),
                        (Check(told, Basis.PROJECT, same, SECTION),))
        )  # fmt: skip
    studies = _studies(ours)
    for finding, place in CLAIMS.items():
        checks = tuple(_finding(basis, study, finding) for basis, study in studies.items())
        rows.append(PaperNumber(TOPIC, PLACE, "finding", ours.published["claims"][place], checks))
    for where, text, rule in STATEMENTS:
        checks = tuple(_statement(basis, study, rule) for basis, study in studies.items())
        rows.append(PaperNumber(TOPIC, where, "statement", text, checks))
    reason = unchecked("its values are not printed")
    rows.append(PaperNumber(TOPIC, FIGURE, "actions by r and costs", "picture",
                            (Check("–", Basis.DATA, reason, SECTION),)))  # fmt: skip
    return rows


# -- models ----------------------------------------------------------------------------------------
def _studies(ours: Ours) -> dict[Basis, SensitivityStudy | str]:
    """The grid under each model that is known, or why it cannot be worked out."""
    out: dict[Basis, SensitivityStudy | str] = {}
    if ours.truth is not None:
        out[Basis.TRUTH] = _study(ours.truth)
    states = ours.published["em"]["selected_states"]
    unseen = unseen_actions(evidence_of_actions(ours.log, _pins(ours)), ours.log.protocol)
    if states not in ours.study.fits:
        out[Basis.DATA] = f"no model with {states} states was fitted"
    elif unseen:
        out[Basis.DATA] = f"the data say nothing about {', '.join(unseen)}"
    else:
        out[Basis.DATA] = _study(ours.study.fits[states].model)
    return out


def _pins(ours: Ours) -> tuple[str, ...]:
    return tuple(next(iter(ours.study.fits.values())).settings.pins)


def _study(model: LatentStatePOMDP) -> SensitivityStudy:
    return sensitivity_study(ModelDraws.from_models([model]), effort=EFFORT)


# -- findings --------------------------------------------------------------------------------------
def _finding(basis: Basis, study: SensitivityStudy | str, key: str) -> Check:
    if isinstance(study, str):
        return Check("–", basis, unchecked(study), SECTION)
    found = [f for f in study.findings if f.key == key]
    told = "; ".join(f"{READING_LABELS[f.reading]}: {f.verdict}" for f in found)
    return Check(told, basis, readings([HOLDS.get(f.verdict) for f in found]), SECTION)


def _statement(basis: Basis, study: SensitivityStudy | str, rule: Rule) -> Check:
    if isinstance(study, str):
        return Check("–", basis, unchecked(study), SECTION)
    found = {reading: rule(grid) for reading, grid in study.maps.items()}
    told = "; ".join(f"{READING_LABELS[reading]}: {text}" for reading, (_, text) in found.items())
    return Check(told, basis, readings([holds for holds, _ in found.values()]), SECTION)


def _cells(found: GridDecisions) -> tuple[Array, Array, Array]:
    """Steepness and both costs of every cell."""
    r = np.array([r for r, _ in found.grid.cells])
    costs = np.array([c for _, c in found.grid.cells])
    return r, costs[:, 0], costs[:, 1]


def _acting(found: GridDecisions) -> list[Array]:
    """How often the costly action of each axis is taken in every cell."""
    return [found.acting(axis.mode).mean(axis=1) for axis in found.grid.axes]


def _like_always(found: GridDecisions) -> tuple[bool, str]:
    """At the steepest r it helps, and signals, in more than half of the cost cells."""
    r, *_ = _cells(found)
    helps, signals = (float(acts[r == r.max()].mean()) for acts in _acting(found))
    return helps > HALF and signals > HALF, f"at r {r.max():g} helps in {helps:.0%}, signals in {signals:.0%}"


def _defaults(found: GridDecisions) -> tuple[bool, str]:
    """It helps in less than half of the cells with the highest cost of helping or the smallest r."""
    r, cost, _ = _cells(found)
    helps = _acting(found)[0]
    costly, flat = float(helps[cost == cost.max()].mean()), float(helps[r == r.min()].mean())
    return (
        costly < HALF and flat < HALF,
        f"helps in {costly:.0%} at cost {cost.max():g}, {flat:.0%} at r {r.min():g}",
    )


def _conservative(found: GridDecisions) -> tuple[bool, str]:
    """At the smallest r it never takes an action that costs something."""
    r, *costs = _cells(found)
    shares = [
        float(acts[(r == r.min()) & (cost > 0)].mean()) for acts, cost in zip(_acting(found), costs, strict=True)
    ]
    return max(shares) == 0, f"at r {r.min():g} pays for help in {shares[0]:.0%}, for signals in {shares[1]:.0%}"


STATEMENTS: tuple[tuple[str, str, Rule], ...] = (
    ("Sec. V-A", "when rewards for higher prosocial states outweigh action costs, the ls-POMDP behaves similarly "
     "to Always Help", _like_always),
    (PLACE, "when either the cost of helping is high or the reward differences are small, the robot defaults to "
     "no-help", _defaults),
    (PLACE, "in regimes with low r, the robot adopts a conservative strategy, avoiding cost-incurring actions",
     _conservative),
)  # fmt: skip
"""What the text says besides, where, and the rule by which it is read."""
