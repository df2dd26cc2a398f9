"""Part of "What decisions depend on": a reward that was stated for the report, everything in it moved in turn."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis.figures.critical_values import READING_LABELS
from analysis.figures.style import spoken
from analysis.kappa_sensitivity import KAPPAS
from analysis.own_sensitivity import BELIEF, COSTS, DISCOUNT, PRIOR, WORTH, OwnSensitivity, own_sensitivity
from analysis.report.context import ReportContext
from analysis.report.doubts import doubts, told_above
from analysis.report.own_reward import planned_states, rewarded_draws, title_of
from analysis.report.section import Block, NotSupported, Part, Table, Text, attempt, with_something
from analysis.sensitivity import READING_WORDS
from analysis.sensitivity_variants import Beside
from analysis.wording import counted
from models.model_draws import ModelDraws
from models.parameters import STICKY
from models.unseen import without_actions

ENDLESS_DRAWS, FEW_DRAWS = 60, 2000
QUICK_ENDLESS_DRAWS, QUICK_FEW_DRAWS = 20, 200

TITLES = {
    COSTS: "Other costs", WORTH: "Other worth of the states", DISCOUNT: "Other discounts",
    BELIEF: "Other initial beliefs", PRIOR: "Other priors: kappa, the pseudo-counts on staying",
}  # fmt: skip


def own_blocks(context: ReportContext, unseen: tuple[str, ...]) -> tuple[Block, ...]:
    """The introduction, and one part for each number of states with a reward.

    Parameters
    ----------
    context : ReportContext
        With a stated reward.
    unseen : tuple of str
        Actions that the data hold no evidence on.
    """
    order = ", then ".join(spoken(m.name) for m in context.protocol.modes)
    text = (
        "What states are worth and what actions cost was stated, not learned. Here each of these numbers is moved "
        "while everything else stays, and so are discount, initial belief and prior. Decisions are those of one "
        f"round of each mode in turn ({order}; steps 0, 1, ...), from the learned initial belief, in three "
        "readings: the policy without a horizon (discount 0.95, modes in turn), the exact plan of these rounds "
        "alone, and the same with the state after them rewarded. Without a horizon a decision is made only where "
        "bounds of what the actions are worth do not overlap; otherwise it is undecided."
    )
    shown = planned_states(context)
    parts = [
        Part(
            title_of(context, k), f"sensitivity-{k}",
            attempt("what decisions depend on", partial(_model, context, k, unseen)), folded=k != shown[0],
        )
        for k in shown
    ]  # fmt: skip
    return (Text(text), *with_something(parts))


def _model(context: ReportContext, k: int, unseen: tuple[str, ...]) -> tuple[Block, ...]:
    if k == 1:
        raise NotSupported("with one state nothing the robot does changes anybody, so it does best to do nothing")

    def drawn(kappa: float) -> ModelDraws:
        return without_actions(rewarded_draws(context, context.posterior(k, kappa).draws()), unseen)

    quick = context.effort.quick
    tell, label = context.progress, counted(k, "state")
    study = context.kept(
        f"sensitivity to a stated reward, {label}", own_sensitivity, drawn(STICKY.stay),
        beside=[Beside(f"kappa {kappa:g}", drawn(kappa)) for kappa in KAPPAS if kappa != STICKY.stay],
        endless_draws=QUICK_ENDLESS_DRAWS if quick else ENDLESS_DRAWS,
        few_draws=QUICK_FEW_DRAWS if quick else FEW_DRAWS,
        progress=None if tell is None else lambda step, done, total: tell(f"{label}: {step}", done, total),
    )  # fmt: skip
    blocks: list[Block] = [*doubts(context, k, estimate=False)]
    blocks.append(Text(_sentence(study)))
    blocks += [_table(context, study, kind, k) for kind in TITLES if study.rows[kind]]
    asked = "; ".join(f"{READING_WORDS[r]}: {n:,}" for r, n in study.draws.items())
    blocks.append(
        Text(
            f"{'Quick. ' if quick else ''}Draws asked, evenly spaced. {asked[0].upper()}{asked[1:]}. A share of n "
            "draws may be off by 1/sqrt(n) either way.", "note",
        )
    )  # fmt: skip
    return told_above(blocks, study.cautions)


def _sentence(study: OwnSensitivity) -> str:
    said = study.sentence
    for reading, words in READING_WORDS.items():
        said = said.replace(f"{reading}: ", f"{words}: ")
    told = spoken(said)
    return f"What most draws do first, and what changes it. {told[0].upper()}{told[1:]}"


def _table(context: ReportContext, study: OwnSensitivity, kind: str, k: int) -> Table:
    rows: dict[str, dict[str, object]] = {}
    columns = list(dict.fromkeys(f"{r['reading']}-{r['k']}" for r in study.rows[kind]))
    for row in study.rows[kind]:
        name = spoken(str(row["variant"]))
        own = rows.setdefault(name, {"variant": name, **dict.fromkeys(columns, "")})
        own[f"{row['reading']}-{row['k']}"] = f"{spoken(str(row['action']))} {row['agree']}"
    readings = list(dict.fromkeys(r["reading"] for r in study.rows[kind]))
    steps = {reading: sum(c.rsplit("-", 1)[0] == reading for c in columns) for reading in readings}
    headings = {"variant": "variant"} | {c: f"step {c.rsplit('-', 1)[1]}" for c in columns}
    return Table(
        f"sensitivity-{kind}-{k}", pd.DataFrame(list(rows.values())),
        f"{TITLES[kind]}, everything else as it is: the action most draws take, and how many do.",
        (context.origin,), headings=headings,
        groups=(("", 1), *((READING_LABELS[r], n) for r, n in steps.items())),
    )  # fmt: skip
