"""What replicates of study 2 come to: how many lead to each conclusion, printed numbers in their place."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.power_curves import wilson_interval
from analysis.replicates import Progress
from analysis.study2_claims import CLAIMS, Claim
from analysis.study2_learning import EM, TRUTH
from analysis.study2_policies import EXACT, FROM_DRAWS, LS_POMDP
from analysis.study2_replicates import KINDS, Study2Replicates, WorldResult, quantities, replicate_study2
from models.notebook_view import NotebookView

Array = NDArray[np.float64]

LEVEL = 0.95
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)

ALL_PRINTED = "but for what is said of each"
"""Whether the paper's own study leads to all of its conclusions."""

NOT_DECIDABLE = " (not decidable)"

WORDS = {EM: "learned from a study 1", TRUTH: "truth known"}


@dataclass(frozen=True)
class Study2Evidence(NotebookView):
    """Replicates of study 2, by how the robot learned.

    Attributes
    ----------
    settings : dict of str to Study2Replicates
    worlds : dict of str to tuple of WorldResult
    printed : dict of str to float
        Numbers of the paper (`analysis.study2_replicates.quantities`).
    """

    _whose = "simulated"

    settings: Mapping[str, Study2Replicates]
    worlds: Mapping[str, tuple[WorldResult, ...]]
    printed: Mapping[str, float]

    def holds(self, kind: str, planner: str) -> NDArray[np.bool_]:
        """Which studies lead to which claims, ``[world, study, claim]``."""
        return np.stack([w.claims[planner] for w in self.worlds[kind]])

    def claim_rows(self) -> list[dict[str, Any]]:
        """One row a kind of learning, planner and claim: share of studies that lead to it, error and interval.

        Studies of one world share what was learned: the standard error is that of means over worlds, and the
        interval is Wilson's with as many studies as would have that error.
        """
        out = []
        for kind, settings in self.settings.items():
            for planner in settings.planners:
                holds = self.holds(kind, planner)
                whole = holds[:, :, [c.whole for c in CLAIMS]].all(axis=2)
                columns = [(c.key, c.name, c.text, c.printed, c.whole) for c in CLAIMS]
                columns.append(("all", "all of them", "all conclusions together", ALL_PRINTED, True))
                for (key, name, text, printed, is_whole), own in zip(
                    columns, [*np.moveaxis(holds, 2, 0), whole], strict=True
                ):
                    row = {"learning": kind, "planner": planner, "claim": key, "name": name, "text": text}
                    out.append({**row, "printed": printed, "whole": is_whole, **_share(own, kind == EM)})
        return out

    def number_rows(self) -> list[dict[str, Any]]:
        """One row a kind of learning, planner and printed number: its distribution over studies.

        ``below`` is the share of studies with a smaller number than the printed one.
        """
        out = []
        for kind, settings in self.settings.items():
            for planner in settings.planners:
                values = np.concatenate([w.numbers[planner] for w in self.worlds[kind]])
                for (name, printed), column in zip(self.printed.items(), values.T, strict=True):
                    found = column[np.isfinite(column)]
                    spread = np.quantile(found, QUANTILES) if len(found) else np.full(len(QUANTILES), np.nan)
                    out.append(
                        {
                            "learning": kind, "planner": planner, "number": name, "printed": printed,
                            **{f"q{round(100 * q):02d}": float(v) for q, v in zip(QUANTILES, spread, strict=True)},
                            "below": float(np.mean(found < printed)) if len(found) else float("nan"),
                            "without": int(len(column) - len(found)),
                        }
                    )  # fmt: skip
        return out

    def mean_rows(self) -> list[dict[str, Any]]:
        """One row a kind of learning, policy and measure: mean over worlds and its standard error."""
        out = []
        for kind, settings in self.settings.items():
            for measure in self.worlds[kind][0].means:
                values = np.stack([w.means[measure] for w in self.worlds[kind]])
                error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
                for i, policy in enumerate(settings.policies):
                    row = {"learning": kind, "policy": policy, "measure": measure}
                    out.append({**row, "mean": float(values[:, i].mean()), "se": float(error[i])})
        return out

    def share(self, kind: str, planner: str, claim: str) -> float:
        """Share of studies that lead to a claim."""
        place = [c.key for c in CLAIMS].index(claim)
        return float(self.holds(kind, planner)[:, :, place].mean())

    def mean(self, kind: str, policy: str, measure: str) -> float:
        """Mean of a measure under a policy."""
        place = self.settings[kind].policies.index(policy)
        return float(np.mean([w.means[measure][place] for w in self.worlds[kind]]))

    @property
    def sentence(self) -> str:
        """What the conclusions came to, for the paper's own policy."""
        return str(self.to_dict()["sentence"])

    def to_dict(self) -> dict[str, Any]:
        """The result as a file holds it."""
        content: dict[str, Any] = {
            "settings": {
                kind: {
                    "replicates": s.replicates, "worlds": s.worlds, "people": s.people, "study1": s.study1,
                    "states": s.states, "alpha": s.alpha, "draws": s.sampler.draws, "tune": s.sampler.tune,
                    "chains": s.sampler.chains, "policies": list(s.policies),
                }
                for kind, s in self.settings.items()
            },
            "game": game_settings(),
            "claims": self.claim_rows(), "numbers": self.number_rows(), "means": self.mean_rows(),
            "claim_keys": [c.key for c in CLAIMS],
            "by_world": {
                kind: {
                    planner: [w.claims[planner].mean(axis=0).tolist() for w in found]
                    for planner in self.settings[kind].planners
                }
                for kind, found in self.worlds.items()
            },
            "missed": {kind: sum(w.missed for w in found) for kind, found in self.worlds.items()},
            "worlds_with_notes": {
                kind: sum(bool(w.notes) for w in found) for kind, found in self.worlds.items()
            },
        }  # fmt: skip
        return {**content, "sentence": sentence_of(content)}


def study2_evidence(
    settings: Study2Replicates, published: Mapping[str, Any], *, executor: Executor | None = None,
    progress: Progress | None = None,
) -> Study2Evidence:  # fmt: skip
    """Replicate study 2 with a robot that learned, and with one that knows the truth.

    Parameters
    ----------
    settings : Study2Replicates
        Its kind of learning is not used: both are run.
    published : mapping
        Numbers printed in the paper (`analysis.design.published`).
    executor : concurrent.futures.Executor, optional
        Threads of this process by default. No result depends on it.
    progress : callable, optional
    """
    own = {kind: replace(settings, kind=kind) for kind in KINDS}
    worlds = {kind: replicate_study2(s, executor=executor, progress=progress) for kind, s in own.items()}
    return Study2Evidence(own, worlds, quantities(published))


def sentence_of(content: Mapping[str, Any]) -> str:
    """What the conclusions came to, from the content of a file: shares for the paper's own policy, and cautions.

    Parameters
    ----------
    content : mapping
        Of `Study2Evidence.to_dict`, or read from a file.
    """
    share = {(r["learning"], r["planner"], r["claim"]): float(r["share"]) for r in content["claims"]}
    parts = []
    for kind, settings in content["settings"].items():
        how = (
            f"the robot had learned from one of {settings['worlds']:,} simulated studies 1"
            if kind == EM
            else "the robot knew the truth"
        )
        told = "; ".join(
            f"{c.name}{f' {_percent(share[kind, LS_POMDP, c.key])}' if decidable(kind, c) else NOT_DECIDABLE}"
            for c in CLAIMS
            if c.whole
        )
        parts.append(
            f"Of {settings['replicates']:,} simulated studies 2 in which {how}, so many lead to the paper's "
            f"conclusions about {LS_POMDP}: {told}; all of them {_percent(share[kind, LS_POMDP, 'all'])}."
        )
    return " ".join([*parts, *_scale_of(content), *_noted(content), *_contradicted(content)])


def _scale_of(content: Mapping[str, Any]) -> list[str]:
    """Why conclusions on the robot's own scale are not decidable: how far apart worlds are."""
    out = []
    for kind in content["settings"]:
        for claim in (c for c in CLAIMS if c.whole and not decidable(kind, c)):
            place = content["claim_keys"].index(claim.key)
            shares = np.array([world[place] for world in content["by_world"][kind][LS_POMDP]])
            out.append(
                f"Whether {claim.name} is not decidable with a robot that has learned: belief is on the scale of "
                f"its fit, and of {len(shares)} such robots {int((shares == 0).sum())} lead to it in no study and "
                f"{int((shares == 1).sum())} in every one."
            )
    return out


def _noted(content: Mapping[str, Any]) -> list[str]:
    """In how many worlds something that was learned is not to be relied on."""
    out = []
    for kind, many in content["worlds_with_notes"].items():
        if many:
            out.append(
                f"In {many} of {content['settings'][kind]['worlds']} worlds something that was learned carries a "
                "warning: a search or a solver that stopped early, or a posterior that did not pass its "
                f"convergence gate. Only {' and '.join(FROM_DRAWS)} rest on posteriors; what is said of them holds "
                "with that reservation."
            )
    return out


def _contradicted(content: Mapping[str, Any]) -> list[str]:
    """What the truth itself says otherwise than the paper, with a robot that knows it."""
    if TRUTH not in content["settings"]:
        return []
    mean = {(r["policy"], r["measure"]): float(r["mean"]) for r in content["means"] if r["learning"] == TRUTH}
    best = EXACT if EXACT in content["settings"][TRUTH]["policies"] else LS_POMDP
    rate, always = (mean[p, "observation"] for p in (best, "always"))
    costly, own = (mean[p, "costly_actions"] for p in ("myopic", LS_POMDP))
    less = "less" if rate < always else "more"
    myopic = "myopic takes no costly action, so it is never" if costly == 0 else f"myopic takes {costly:.1f}"
    return [
        f"With the truth known, people help {less} under the best plan ({rate:.1%}) than under always "
        f"({always:.1%}), {LS_POMDP} takes {own:.1f} costly actions, and {myopic}."
    ]


def decidable(kind: str, claim: Claim) -> bool:
    """Whether studies in which the robot learned like this can decide a conclusion.

    Examples
    --------
    >>> [(c.key, decidable("em", c)) for c in CLAIMS if c.own_scale]
    [('belief', False)]
    """
    return kind == TRUTH or not claim.own_scale


def shown_claims(content: Mapping[str, Any]) -> pd.DataFrame:
    """Rows of `Study2Evidence.claim_rows` as they are shown: what is not decidable says so and has no share."""
    rows = pd.DataFrame(content["claims"])
    by_key = {c.key: c for c in CLAIMS}
    off = np.array(
        [
            key in by_key and not decidable(kind, by_key[key])
            for kind, key in zip(rows["learning"], rows["claim"], strict=True)
        ]
    )
    rows.loc[off, ["share", "se", "low", "high"]] = np.nan
    rows.loc[off, "name"] = rows.loc[off, "name"] + NOT_DECIDABLE
    return rows


def reworded(content: Mapping[str, Any]) -> dict[str, Any]:
    """Content of a file with names, texts, remarks and sentence as they are now; no number is touched."""
    words = {c.key: {"name": c.name, "text": c.text, "printed": c.printed} for c in CLAIMS}
    words["all"] = {"printed": ALL_PRINTED}
    rows = [{**row, **words[row["claim"]]} for row in content["claims"]]
    return {**content, "claims": rows, "sentence": sentence_of(content)}


def game_settings() -> dict[str, Any]:
    """Map and parameters that the game has by default: numbers made with others are of another game."""
    from models.game.layout import packaged
    from models.game.parameters import GameParameters

    return {"map": list(packaged().lines), "parameters": GameParameters().to_dict()}


def _share(holds: NDArray[np.bool_], by_world: bool) -> dict[str, float]:
    """Share, standard error and interval of claims ``[world, study]``."""
    worlds, studies = holds.shape
    share = float(holds.mean())
    if by_world:
        error = float(holds.mean(axis=1).std(ddof=1) / np.sqrt(worlds))
        # Where all studies agree, nobody knows how much worlds differ; the worlds themselves are independent.
        effective = min(worlds * studies, share * (1 - share) / error**2) if error > 0 else float(worlds)
    else:
        effective = float(worlds * studies)
        error = float(np.sqrt(share * (1 - share) / effective))
    low, high = wilson_interval(np.array([share * effective]), effective, LEVEL)
    return {"share": share, "se": error, "low": float(low[0]), "high": float(high[0])}


def _percent(share: float) -> str:
    """A share as it is said: none and all only where it is none and all.

    Examples
    --------
    >>> _percent(0.0), _percent(0.0004), _percent(0.9996), _percent(0.25)
    ('none', 'under .1%', 'over 99.9%', '25.0%')
    """
    if share in (0.0, 1.0):
        return "all" if share else "none"
    if share < 0.001:
        return "under .1%"
    return "over 99.9%" if share > 0.999 else f"{share:.1%}"
