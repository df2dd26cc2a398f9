"""Section: what the robot's decisions depend on, and the paper's findings about that beside what is found here."""

from __future__ import annotations

from functools import partial
from typing import Any

import pandas as pd

from analysis.figures.sensitivity import READING_LABELS, action_map, critical_values, share_map
from analysis.figures.style import spoken
from analysis.kappa_sensitivity import KAPPAS
from analysis.report.context import ReportContext
from analysis.report.doubts import doubts, reservations, told_above
from analysis.report.own_reward import planned_states, title_of, unseen_or_left_out, want_reward
from analysis.report.section import (
    Block,
    Figure,
    NotSupported,
    Omitted,
    Origin,
    Part,
    Points,
    Table,
    Text,
    attempt,
    with_something,
)
from analysis.report.sections.plan import known_truth
from analysis.report.sections.sensitivity_own import own_blocks
from analysis.sensitivity import READING_WORDS, READINGS, SensitivityEffort, SensitivityStudy, sensitivity_study
from analysis.sensitivity_variants import CURRENCIES, Beside, game_scores
from analysis.wording import counted
from models.errors import located
from models.model_draws import ModelDraws
from models.parameters import STICKY
from models.sensitivity.flips import Flips
from models.sensitivity.reward_grid import ENOUGH, ENOUGH_TO_BE_SURE, LEANING, ROUNDING, SURE, UNDECIDED
from models.unseen import without_actions

EFFORT = SensitivityEffort(
    endless_draws=60, endless_variants=60, endless_critical=25, endless_certain=25, few_draws=2000,
    few_critical=400, scan=33, endless_scan=13, moved=False,
)  # fmt: skip
QUICK = SensitivityEffort(
    endless_draws=20, endless_variants=20, endless_critical=10, endless_certain=10, few_draws=400, few_critical=100,
    scan=17, endless_scan=9, moved=False,
)  # fmt: skip
ONLY_MAPS = SensitivityEffort(critical=False, variants=False)
"""For point estimates and a known truth: the grid and the findings."""

SHORT = READING_LABELS

FINDINGS = {
    "helping": ("helping", "step 0: helping is dominant only for r >= 0.08"),
    "signalling": (
        "signalling", "step 1, after helping: a signal is more likely, especially for r >= 0.06 and moderate or "
        "low cost; at steep r even at higher costs",
    ),
    "contrast": ("contrast", "signalling is more state- and cost-sensitive than helping"),
}  # fmt: skip
"""Row headings of the paper's findings, and what it prints of each."""


def make(context: ReportContext) -> tuple[Block, ...]:
    """The numbers of states beside each other, then one part for each that is shown in full."""
    want_reward(context)
    unseen = unseen_or_left_out(context)
    blocks: list[Block] = [Text(_introduction(context))] if context.stated is None else []
    blocks += reservations(context)
    if unseen:
        names = " and ".join(spoken(a) for a in unseen)
        blocks.append(
            Text(
                f"Left out: {names}. The data hold no evidence on it; decisions would rest on the prior.", "warning"
            )
        )
    if context.stated is not None:
        return (*blocks, *own_blocks(context, unseen))
    beside = attempt("numbers of states beside each other", partial(_states, context, unseen))
    shown, parts = planned_states(context), []
    for k in shown:
        made = attempt("what decisions depend on", partial(_model, context, k, unseen))
        parts.append(Part(title_of(context, k), f"sensitivity-{k}", made, folded=k != shown[0]))
    if all(isinstance(block, Omitted) for block in beside):
        parts = [*with_something(parts)]
    return (*blocks, *beside, *parts)


def _introduction(context: ReportContext) -> str:
    grid = context.published["sensitivity"]
    r, costs = (", ".join(f"{v:g}" for v in grid[key]) for key in ("r", "cost_help"))
    return (
        f"The paper varies the steepness of the reward and both costs (r in {r}; costs in {costs}) and records two "
        "decisions from the learned initial belief: whether to help a person in need (step 0), then whether to "
        "signal in need of help (step 1), at the belief after what was done. It prints neither a discount nor what "
        "comes after the second step, so three readings are shown: the policy without a horizon (discount 0.95, "
        "modes in turn), the exact two-step plan, and the same with the prosocial reward of the state after it "
        "(both undiscounted). Without that reward the second step cannot pay, so a signal is never sent. Without a "
        "horizon a decision is made only where bounds of what the actions are worth do not overlap; otherwise it "
        "is undecided."
    )


# -- numbers of states -------------------------------------------------------------------------------
def _states(context: ReportContext, unseen: tuple[str, ...]) -> tuple[Block, ...]:
    """Decisions of the point estimates at the paper's reward, with the warning about currencies."""
    rows = []
    for k in context.study.states:
        if k < 2:
            continue
        draws = without_actions(ModelDraws.from_models([context.study.fits[k].model]), unseen)
        effort = SensitivityEffort(critical=False, variants=False)
        study = context.kept(
            f"decisions of the estimate, {counted(k, 'state')}", sensitivity_study, draws, r=(draws_r(draws),),
            costs=(15.0,), effort=effort,
        )  # fmt: skip
        row: dict[str, object] = {"states": k}
        for reading, found in study.maps.items():
            for own in found.rows():
                row[f"{reading}-{own['k']}"] = spoken(own["action"])
        rows.append(row)
    if len(rows) < 2:
        raise NotSupported("only one number of states was fitted")
    frame = pd.DataFrame(rows)
    headings = {"states": "states"} | {
        f"{r}-{k}": f"step {k}" for r in READINGS for k in range(len(context.protocol.modes))
    }
    groups = (("", 1), *((SHORT[r], len(context.protocol.modes)) for r in READINGS))
    table = Table(
        "sensitivity-states", frame,
        "What the point estimates of different numbers of states do at the paper's reward (r 0.06, costs 15). "
        "Values in different currencies; only actions compare.", (context.origin,), headings=headings,
        groups=groups,
    )  # fmt: skip
    capped = [k for k in frame["states"] if not context.study.fits[k].converged]
    warned = f"With {' and '.join(map(str, capped))} states Baum-Welch did not converge: do not rely on these rows."
    return Text(CURRENCIES, "warning"), *([Text(warned, "warning")] if capped else []), table


def draws_r(draws: ModelDraws) -> float:
    """Steepness of the draws' own reward."""
    from models.sensitivity.reward_grid import reward_of

    return reward_of(draws).r


# -- one number of states ----------------------------------------------------------------------------
def _model(context: ReportContext, k: int, unseen: tuple[str, ...]) -> tuple[Block, ...]:
    if k == 1:
        raise NotSupported("with one state nothing the robot does changes anybody, so it does best to do nothing")
    quick = context.effort.quick
    draws = without_actions(context.posterior(k).draws(), unseen)
    kappas = [kappa for kappa in KAPPAS if kappa != STICKY.stay]
    beside = [
        Beside(f"kappa {kappa:g}", without_actions(context.posterior(k, kappa).draws(), unseen)) for kappa in kappas
    ]
    tell, label = context.progress, counted(k, "state")
    study = context.kept(
        f"sensitivity of the draws, {label}", sensitivity_study, draws, beside=beside, scores=game_scores(k),
        effort=QUICK if quick else EFFORT,
        progress=None if tell is None else lambda step, done, total: tell(f"{label}: {step}", done, total),
    )  # fmt: skip
    estimate = context.kept(
        f"sensitivity of the estimate, {label}", sensitivity_study,
        without_actions(ModelDraws.from_models([context.study.fits[k].model]), unseen), effort=ONLY_MAPS,
    )  # fmt: skip
    truth = known_truth(context)
    in_truth = None if truth is None else context.kept(
        "sensitivity in the truth", sensitivity_study, ModelDraws.from_models([truth]), effort=ONLY_MAPS
    )  # fmt: skip
    blocks: list[Block] = [*doubts(context, k)]
    blocks += _maps(context, study, estimate, k)
    blocks += _findings(context, study, estimate, in_truth, k)
    blocks += _critical(context, study, k)
    blocks += _failed_refits(context, k, kappas)
    blocks += _variants(context, study, k)
    blocks.append(Text(f"{'Quick. ' if quick else ''}{_asked(study)}", "note"))
    return told_above(told_above(blocks, study.cautions), estimate.cautions)


def _failed_refits(context: ReportContext, k: int, kappas: list[float]) -> tuple[Block, ...]:
    """Which of the refits with other priors are not to be relied on."""
    failed = [f"{kappa:g}" for kappa in kappas if not context.posterior(k, kappa).gate.passed]
    if not failed:
        return ()
    named = " and ".join(failed)
    text = f"The convergence gate FAILED at kappa {named}: do not rely on what is said of these priors."
    return (Text(text, "warning"),)


def _asked(study: SensitivityStudy) -> str:
    """How many draws answered what."""
    parts = []
    for reading, found in study.maps.items():
        flips = next((len(f.weight) for f in study.critical if f.reading == reading), None)
        others = [row["draws"] for rows in study.variants.values() for row in rows if row["reading"] == reading]
        own = [f"{found.n_draws:,} about the grid"]
        own += [f"{max(others):,} about discount, scores, belief, prior"] if others else []
        own += [f"{flips:,} about flips"] if flips is not None else []
        certain = next((f.draws for f in study.findings if (f.key, f.reading) == ("contrast", reading)), None)
        own += [f"{certain:,} about certainty of a state"] if certain is not None else []
        parts.append(f"{READING_WORDS[reading]}: {', '.join(own)}")
    return (
        f"Draws asked, evenly spaced. {'. '.join(p[0].upper() + p[1:] for p in parts)}. A share of n draws may be "
        "off by 1/sqrt(n) either way: 0.32 with 10 draws, 0.2 with 25, 0.1 with 100."
    )


def _maps(context: ReportContext, study: SensitivityStudy, estimate: SensitivityStudy, k: int) -> tuple[Block, ...]:
    said = spoken(estimate.sentence)
    readings = tuple(study.maps)
    # Drawing takes longer than deciding: a quick report draws one reading, and says what all of them come to.
    shown = readings[:1] if context.effort.quick else readings
    names = "; ".join(READING_WORDS[r] for r in shown)
    below = f"From top to bottom: {names}." if len(shown) > 1 else f"{names[0].upper()}{names[1:]}."
    words = tuple(f"{READING_WORDS[r]}: see the text." for r in shown)
    published = Figure(
        f"sensitivity-actions-{k}", tuple(partial(action_map, estimate.maps[r]) for r in shown),
        "The paper's figure, made from the point estimate as the paper does: what is done at each step (down) and "
        f"each r (across), over the costs. {below} Letters and hatching say what the colours say.",
        words, (context.origin,),
    )  # fmt: skip
    few = [f"{SHORT[r]}: {study.maps[r].n_draws:,}" for r in shown]
    shares = Figure(
        f"sensitivity-shares-{k}", tuple(partial(share_map, study.maps[r]) for r in shown),
        "The same over the draws of the posterior, each deciding for itself at its own belief: how many of them "
        f"act, in percent (fewer than {ENOUGH} draws are counted). Crossed cells are a toss: fewer than "
        f"{LEANING:.0%} of at least {ENOUGH} draws agree on any action. Draws, {'; '.join(few)}.",
        words, (context.origin,),
    )  # fmt: skip
    blocks: list[Block] = [Text(f"Point estimate: {said}"), published, Text(_sureness(study)), shares]
    if len(shown) < len(readings):
        rest = " and ".join(READING_WORDS[r] for r in readings[len(shown) :])
        blocks.append(Text(f"Quick: maps of the other readings ({rest}) are not drawn.", "note"))
    return tuple(blocks)


def _sureness(study: SensitivityStudy) -> str:
    """How much of each map is knowledge, as far as so many draws can say."""
    parts = []
    for reading, found in study.maps.items():
        rows, n = found.rows(), found.n_draws
        steps = []
        for k in range(found.n_steps):
            own = [row for row in rows if row["k"] == k]
            verdicts = [row["verdict"] for row in own]
            if n >= ENOUGH_TO_BE_SURE:
                text = f"{verdicts.count('sure')} sure"
            else:
                text = f"all agree in {sum(row['share'] >= 1 - ROUNDING for row in own)}"
            if n >= ENOUGH:
                text += f", {verdicts.count('coin toss') + verdicts.count(UNDECIDED)} a toss"
            steps.append(f"step {k}: {text}")
        least = (
            "" if n >= ENOUGH_TO_BE_SURE else f" (all of {n} may still be {0.05 ** (1 / n):.0%} of the posterior)"
        )
        parts.append(
            f"{READING_WORDS[reading]}, {n:,} draws, of {len(found.grid.cells)} cells {'; '.join(steps)}{least}"
        )
    return (
        f"How many cells are knowledge (sure: at least {SURE:.0%} of at least {ENOUGH_TO_BE_SURE} draws agree) and "
        f"how many a toss (fewer than {LEANING:.0%} of at least {ENOUGH}): "
        f"{'. '.join(p[0].upper() + p[1:] for p in parts)}."
    )


def _findings(
    context: ReportContext, study: SensitivityStudy, estimate: SensitivityStudy,
    in_truth: SensitivityStudy | None, k: int,
) -> tuple[Block, ...]:  # fmt: skip
    if not study.findings:
        text = "The paper's findings compare helping with signalling; with one left out they cannot be checked."
        return (Text(text, "note"),)
    if len(estimate.findings) != len(study.findings):
        raise located("findings of the point estimate", len(estimate.findings), str(len(study.findings)))
    rows: dict[str, dict[str, str]] = {}
    for i, found in enumerate(study.findings):
        row = rows.setdefault(found.key, {"printed": FINDINGS[found.key][1]})
        row[found.reading] = (
            f"point: {estimate.findings[i].verdict}; draws: {found.holds_in.removesuffix(' draws')}"
        )
        if in_truth is not None:
            row[found.reading] += f"; truth: {in_truth.findings[i].verdict}"
    origin: tuple[Origin, ...] = (Origin.PRINTED, context.origin)
    if in_truth is not None:
        origin = (*origin, Origin.DEFINITION)
    table = Table(
        f"sensitivity-findings-{k}", pd.DataFrame(list(rows.values())),
        "The paper's three findings, and whether they come out here, by reading: in the point estimate (point)"
        f"{'' if in_truth is None else ', in the truth'}, and in how many draws everything that decides a finding "
        "holds. How each is decided stands below.",
        origin, headings={"printed": "finding", **SHORT}, printed=("printed",), wraps=True,
    )  # fmt: skip
    told = tuple(f"{FINDINGS[f.key][0].capitalize()}, {SHORT[f.reading]}: {f.sentence}" for f in study.findings)
    lead = "The numbers that decide; (beside) marks those that do not"
    return table, Points(told, lead)


def _critical(context: ReportContext, study: SensitivityStudy, k: int) -> tuple[Block, ...]:
    wanted = [("r", step) for step in range(len(context.protocol.modes))]
    wanted += [(f"cost_{axis.name}", axis.mode) for axis in study.grid.axes]
    panels, alt = [], []
    for name, step in wanted:
        found: list[Flips] = [flips[step] for r in study.maps if len(flips := study.flips(r, name)) > step]
        if found:
            panels.append(partial(critical_values, found))
            alt.append(
                f"Step {step}, {spoken(name)}: {'; '.join(f'{SHORT[f.reading]}, {f.sentence}' for f in found)}."
            )
    if not panels:
        raise NotSupported("no critical values were looked for")
    counts = {SHORT[f.reading]: len(f.weight) for f in study.critical}
    spacing = max((f.spacing for f in study.critical if f.parameter == "r"), default=0.0)
    figure = Figure(
        f"sensitivity-critical-{k}", tuple(panels),
        "Where decisions flip as one number moves and everything else stays at the paper's values (r 0.06, costs "
        "15): share of the draws that have flipped by then, found by bisection in every draw. A curve that ends "
        "low leaves draws that never flip in the range. Draws, "
        f"{'; '.join(f'{name}: {n:,}' for name, n in counts.items())}. Two flips that undo each other between "
        f"neighbouring points of the first scan (r: {spacing:.2g} apart) would be missed.",
        tuple(alt), (context.origin,),
    )  # fmt: skip
    said = tuple(
        spoken(f"{SHORT[f.reading]}, {f.sentence.rstrip('.')}.")
        for f in study.critical
        if f.parameter == "r" and len(f.draw)
    )
    return figure, Points(said, "At which r decisions flip")


def _variants(context: ReportContext, study: SensitivityStudy, k: int) -> tuple[Block, ...]:
    titles = {
        "discount": "Other discounts", "x": "Other scores of the states (tokens a round)",
        "belief": "Other initial beliefs", "beside": "Other priors: kappa, the pseudo-counts on staying",
    }  # fmt: skip
    tables: list[Block] = []
    for kind, title in titles.items():
        rows = study.variants[kind]
        if not rows:
            continue
        frame = pd.DataFrame(_wide(rows))
        columns = [c for c in frame.columns if c != "variant"]
        headings = {"variant": "variant"} | {c: f"step {c.rsplit('-', 1)[1]}" for c in columns}
        shown = [r for r in study.maps if any(c.startswith(f"{r}-") and c.rsplit("-", 1)[0] == r for c in columns)]
        per = len(context.protocol.modes)
        origin = (context.origin, Origin.DEFINITION) if kind == "x" else (context.origin,)
        tables.append(
            Table(
                f"sensitivity-{kind}-{k}", frame,
                f"{title}, everything else at the paper's values: the action most draws take, and how many do.",
                origin, headings=headings,
                groups=(("", 1), *((f"{SHORT[r]}{_number(rows, r)}", per) for r in shown)),
            )
        )  # fmt: skip
    return (Part("Discount, scores, belief, prior", f"sensitivity-variants-{k}", tuple(tables), True),)


def _number(rows: tuple[dict[str, Any], ...], reading: str) -> str:
    """Number of draws behind the columns of a reading, where it is one."""
    asked = {row["draws"] for row in rows if row["reading"] == reading}
    return f", {asked.pop():,} draws" if len(asked) == 1 else ""


def _wide(rows: tuple[dict[str, Any], ...]) -> list[dict[str, object]]:
    """One row a variant; every reading and step a column, empty where a reading was not asked."""
    out: dict[str, dict[str, object]] = {}
    columns = list(dict.fromkeys(f"{row['reading']}-{row['k']}" for row in rows))
    for row in rows:
        name = str(row["variant"])
        own = out.setdefault(name, {"variant": name, **dict.fromkeys(columns, "")})
        agree = str(row["agree"])
        if _number(rows, row["reading"]):
            # The heading has the number of draws.
            whole = f" of {row['draws']:,} draws"
            agree = agree.replace(whole, "" if row["draws"] >= ENOUGH else f"/{row['draws']}")
        own[f"{row['reading']}-{row['k']}"] = f"{spoken(str(row['action']))} {agree}"
    return list(out.values())
