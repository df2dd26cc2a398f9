"""Section: stored evidence on the method itself, from studies that are too slow for a report."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from analysis.evidence import Evidence
from analysis.figures.rank_ecdf import rank_ecdf
from analysis.figures.recovery import recovery_coverage, recovery_errors, states_found
from analysis.figures.style import spoken
from analysis.report.context import ReportContext
from analysis.report.section import Block, Drawing, Figure, NotSupported, Origin, Part, Table, Text
from analysis.report.stored import stored
from analysis.wording import counted
from models.gate import MIN_ESS

SIMULATED = (Origin.SIMULATED,)


def make(context: ReportContext) -> tuple[Block, ...]:
    """Calibration and recovery, for studies of the design they were made for."""
    if not context.is_published_schedule:
        raise NotSupported(
            "calibration and recovery were studied for the published design, and this study has another"
        )
    intro = (
        "Can the numbers above be trusted? Studies of the method under the published design, with SIMULATED "
        "people whose truth is known. They take too long to be repeated for every report, so these are stored "
        "results. They do not depend on the data of this report."
    )
    return (
        Text(intro, "warning"),
        Part("Is the doubt what it claims to be?", "calibration", stored("calibration", _calibration)),
        Part(
            "Is it where people differ?",
            "calibration-people",
            stored("calibration_people", _calibration, "calibration where people differ"),
        ),
        Part("Is a known truth found again?", "recovery", stored("recovery", _recovery)),
        Part(
            "Do plans that reckon with doubt do better in truth?",
            "plans-in-truth",
            stored("plans_in_truth", _plans_in_truth, "plans in simulated truths"),
        ),
    )


# -- calibration -----------------------------------------------------------------------------------
def _calibration(found: Evidence) -> tuple[Block, ...]:
    content = found.content
    key = found.path.stem.replace("_", "-")
    largest = content["largest_rank"]
    people = ""
    if content["runs"][0]["settings"].get("people") is not None:
        own = content["runs"][0]["settings"]
        people = (
            f" People differ by an offset, with {counted(own['runs_per_person'], 'run')} each; what is said of "
            "states and actions is about the person in the middle."
        )
    rows, statistics, panels, alt = [], [], [], []
    tests = sum(len(run["statistics"]) for run in content["runs"])
    for run in content["runs"]:
        states = run["settings"]["states"]
        long_enough = np.array([np.nan if e is None else e for e in run["min_ess"]]) > MIN_ESS
        ranks = {name: np.asarray(own)[long_enough] for name, own in run["ranks"].items()}
        frame = pd.DataFrame(run["statistics"])
        frame.insert(0, "states", states)
        statistics.append(frame)
        rows.append(
            {
                "states": states, "studies": len(long_enough), "left out": int(np.sum(~long_enough)),
                "statistics": len(frame), "smallest p": float(frame[_p_columns(frame)].to_numpy().min()),
                **{c: float(frame[c].mean()) for c in ("coverage_50", "coverage_90")},
            }
        )  # fmt: skip
        panels.append(
            partial(
                rank_ecdf, ranks, largest, level=content["family_wise"], tests=tests,
                title=counted(states, "state"),
            )
        )  # fmt: skip
        lowest = frame.loc[frame["p_uniform"].idxmin()]
        alt.append(
            f"Ranks at {counted(states, 'state')}: {len(frame)} lines around zero; farthest from uniform is "
            f"{lowest['statistic']}, p {lowest['p_uniform']:.2g}."
        )
    figure = Figure(
        f"{key}-ranks", tuple(panels),
        f"Ranks of simulated truths among {largest} posterior draws, one line a statistic: share of studies up to "
        "a rank, less what uniform ranks would have. All lines stay in the band with probability 99% where "
        f"posteriors are calibrated.{people}",
        tuple(alt), SIMULATED,
    )  # fmt: skip
    summary = Table(
        f"{key}-runs", pd.DataFrame(rows),
        "Calibration by number of states. Left out: studies whose sample did not reach the gate's effective sample "
        "size. Coverages are means over statistics.",
        SIMULATED, headings={"coverage_50": "50% intervals", "coverage_90": "90% intervals"},
        formats={"smallest p": ".4f", "coverage_50": ".3f", "coverage_90": ".3f"},
    )  # fmt: skip
    every = pd.concat(statistics, ignore_index=True)[
        ["states", "statistic", "mean_rank", "coverage_50", "coverage_90", "p_uniform"]
    ]
    details = Table(
        f"{key}-statistics", every,
        "Every statistic: mean rank of the truth (.5 wanted), share of truths inside the central intervals, "
        "p-value of uniform ranks before any correction.",
        SIMULATED, headings={"mean_rank": "mean rank", "coverage_50": "in 50%", "coverage_90": "in 90%",
                             "p_uniform": "p, uniform"},
        formats=dict.fromkeys(("mean_rank", "coverage_50", "coverage_90", "p_uniform"), ".3f"), row_headings=2,
    )  # fmt: skip
    return summary, figure, Part("Every statistic", f"{key}-every", (details,), folded=True)


def _p_columns(frame: pd.DataFrame) -> list[str]:
    return [c for c in frame.columns if c.startswith("p_")]


# -- recovery --------------------------------------------------------------------------------------
def _recovery(found: Evidence) -> tuple[Block, ...]:
    content = found.content
    settings = content["settings"]
    true, studies = settings["true_states"], settings["replicates"]
    table = pd.DataFrame(content["table"])
    shown = true if true in settings["states"] else settings["states"][0]
    own = table[table["states"] == shown]
    by_table = pd.DataFrame(content["by_table"])
    rows = by_table[by_table["states"] == shown]
    panels: list[Drawing] = [
        partial(recovery_errors, own, title=f"Errors, {counted(shown, 'state')}"),
        partial(recovery_coverage, own, studies, title=f"Coverage, {counted(shown, 'state')}"),
    ]
    alt = [
        "Root mean square errors by table (EM, posterior mean, prior mean): "
        + "; ".join(
            f"{spoken(r.table)} {r.em_rmse:.2f}, {r.rmse:.2f}, {r.prior_rmse:.2f}" for r in rows.itertuples()
        )
        + ".",
        "Share of studies whose interval holds the truth (50%, 90% intervals): "
        + "; ".join(f"{spoken(r.table)} {r.coverage_50:.2f}, {r.coverage_90:.2f}" for r in rows.itertuples())
        + ".",
    ]
    chosen = pd.DataFrame(content["chosen"])
    caption = (
        f"{counted(studies, 'simulated study', 'simulated studies')} of {settings['participants']:,} people, truth "
        f"{content['truth']}. First: error of every entry; the bar is the root mean square over a table. Second: "
        "share of studies whose posterior interval holds the truth; exact intervals lie in the bands."
    )
    if len(chosen):
        panels.append(partial(states_found, chosen, true, title="Number of states chosen"))
        told = [
            f"{name}: " + ", ".join(f"{r.states} in {r.studies}" for r in part.itertuples() if r.studies)
            for name, part in chosen.groupby("name", sort=False)
        ]
        alt.append(f"Number of states chosen, by criterion: {'; '.join(told)}.")
        caption += " Third: what each criterion chooses."
    figure = Figure("recovery-figure", tuple(panels), caption, tuple(alt), SIMULATED)
    numbers = ("truth", "em_bias", "em_rmse", "bias", "rmse", "prior_rmse", "coverage_50", "coverage_90",
               "contraction")  # fmt: skip
    columns = ["states", "table", "entry", *numbers]
    every = table[columns].astype(dict.fromkeys(numbers, float))
    every["table"] = every["table"].map(spoken)
    details = Table(
        "recovery-every", every,
        "Every entry where the number of states is the true one, and effects (on the scale of probabilities) for "
        "every number of states.",
        SIMULATED, row_headings=3, formats=dict.fromkeys(numbers, ".3f"),
        headings={"em_bias": "bias", "em_rmse": "error", "rmse": "error", "prior_rmse": "error",
                  "coverage_50": "in 50%", "coverage_90": "in 90%"},
        groups=(("", 4), ("EM", 2), ("posterior mean", 2), ("prior mean", 1), ("posterior", 3)),
    )  # fmt: skip
    return figure, Part("Every entry and effect", "recovery-entries", (details,), folded=True)


# -- plans in simulated truths ---------------------------------------------------------------------
def _plans_in_truth(found: Evidence) -> tuple[Block, ...]:
    shown = {
        "setting": "setting", "plan": "plan", "mean": "mean", "tail": "worst share", "mean_regret": "mean regret",
        "tail_regret": "worst regret", "gain": "gain over plug-in", "gain_low": "from", "gain_high": "to",
    }  # fmt: skip
    frame = pd.DataFrame(found.content["table"])[list(shown)]
    formats = {c: ",.2f" for c in shown if c not in ("setting", "plan")}
    caption = (
        "Plans learned from simulated studies, valued in the truths behind them. Gain: paired with the plan of the "
        "Baum-Welch estimate, 95% interval. Worst share: mean over the worst truths, those of the level above."
    )
    return (Table("plans-in-truth-table", frame, caption, SIMULATED, headings=shown, formats=formats),)
