"""Section: what the robot should do given everything that is believed, and what would be worth learning."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis.figures.information import information_by_block, information_by_people
from analysis.figures.robust import caution, plan_comparison, stability_tree, value_distributions
from analysis.figures.style import spoken
from analysis.next_studies import Asked, next_rounds, own_studies, published_studies
from analysis.report.context import ReportContext
from analysis.report.doubts import doubts, reservations, told_above
from analysis.report.own_reward import (
    planned_states,
    rewarded_draws,
    rewarded_model,
    rounds_in_words,
    rounds_of,
    title_of,
    unseen_or_left_out,
    want_reward,
)
from analysis.report.section import Block, Figure, NotSupported, Part, Points, Table, Text, attempt, with_something
from analysis.report.sections.plan_headlines import under_doubt
from analysis.report.sections.robust_endless import endless_blocks
from analysis.robust_study import RobustStudy, robust_study
from analysis.wording import counted
from models.model_draws import ModelDraws
from models.planning.schedule import Schedule
from models.robust.cautious import acting_words
from models.robust.study_design import NextStudy
from models.robust.study_worth import FEWEST_EFFECTIVE
from models.unseen import without_actions

ALPHA = 0.1
"""Share of the draws that the cautious plans look at."""

SIZES = (50, 100, 200, 400)
NEXT = "HRHRH"
"""Schedule of the further studies that are valued: one of the published ones, both modes in turn."""

QUICK_DRAWS, QUICK_REPLICATES = 200, 20

PLANS = ("Bayes-adaptive", "cautious", "plug-in estimate", "never", "always")
"""Plans whose values are drawn over the draws."""

WRITTEN_OUT = ("Bayes-adaptive", "cautious", "cautious regret", "minimax regret")
MOST_WRITTEN = 3
"""Plans that are written out event by event, and how many of a mixture."""


def make(context: ReportContext) -> tuple[Block, ...]:
    """One part for each number of states that is shown in full."""
    want_reward(context)
    intro = (
        f"The section before takes one table as true. Here every table that the data leave possible has its say: "
        f"each draw of the posterior is planned for, over {rounds_in_words(context)}, exactly. Values are in "
        "reward units a person."
    )
    shown = planned_states(context)
    parts = []
    for k in shown:
        blocks = attempt("plans under doubt", partial(_model, context, k))
        parts.append(Part(title_of(context, k), f"robust-{k}", blocks, folded=k != shown[0]))
    return (Text(intro), *reservations(context), *with_something(parts))


def _model(context: ReportContext, k: int) -> tuple[Block, ...]:
    if k == 1:
        raise NotSupported("with one state nothing the robot does changes anybody, so it does best to do nothing")
    unseen = unseen_or_left_out(context)
    posterior, quick = context.posterior(k), context.effort.quick
    draws = without_actions(rewarded_draws(context, posterior.draws()), unseen)
    if quick:
        draws = draws.thin(QUICK_DRAWS)
    schedule = Schedule.of(draws, rounds_of(context))
    studies = _next_studies(context, draws)
    estimate = rewarded_model(context, k) if not unseen else None
    tell, label = context.progress, counted(k, "state")
    study = context.kept(
        f"plans under doubt, {label}", robust_study, schedule, criterion="cvar", alpha=ALPHA, plug_in=estimate,
        asked=[Asked(s, SIZES) for s in studies], with_frontier=True,
        chains=None if quick else context.effort.chains,
        replicates=QUICK_REPLICATES if quick else 100, seed=context.seed,
        progress=None if tell is None else lambda step, done, total: tell(f"{label}: {step}", done, total),
    )  # fmt: skip
    blocks: list[Block] = [*doubts(context, k, estimate=estimate is not None)]
    if unseen:
        names = " and ".join(spoken(a) for a in unseen)
        blocks.append(
            Text(f"Left out: {names}. The data hold no evidence on it; a plan would rest on the prior.", "warning")
        )
    told = spoken(study.sentence)
    blocks.append(Text(told[0].upper() + told[1:]))
    blocks += _simple_rule(study)
    blocks += _sure(context, study, k)
    blocks += _prices(context, study, k)
    blocks += _caution(context, study, k)
    blocks += _information(context, study, k)
    blocks += endless_blocks(context, draws, k)
    blocks.append(under_doubt(context, study, posterior.gate))
    if quick:
        blocks.append(
            Text(f"Quick: {draws.n_draws} draws and {QUICK_REPLICATES} simulated data sets a study.", "note")
        )
    return told_above(blocks, study.cautions)


def _simple_rule(study: RobustStudy) -> tuple[Block, ...]:
    """That the best plan under doubt is a simple rule, which a plan for one table need not be."""
    same = study.prices.best_baseline
    if not same:
        return ()
    return (
        Text(
            f"Under all this doubt the best plan is '{spoken(same)}': no plan that listens and learns is worth "
            "more on average over the draws. The section before may begin otherwise, as it takes one table as true."
        ),
    )


def _next_studies(context: ReportContext, draws: ModelDraws) -> tuple[NextStudy, ...]:
    """Studies that could be run next: the published ones, or the arms of the data again beside random actions."""
    if context.is_published_protocol:
        return published_studies(draws.protocol, NEXT)
    return own_studies(context.log, draws.protocol, next_rounds(draws.protocol, rounds_of(context)))


def _sure(context: ReportContext, study: RobustStudy, k: int) -> tuple[Block, ...]:
    named = {"optimum of each draw": study.perfect.optima}
    have = {p.name for p in study.prices.prices}
    named |= {n: study.prices[n].values for n in PLANS if n in have}
    weight = study.perfect.groups.weight
    told = "; ".join(f"{n} {weight @ v:.4g}" for n, v in named.items())
    curves = Figure(
        f"robust-values-{k}", (partial(value_distributions, named, weight),),
        "What plans are worth over the draws of the posterior: each curve says in which share of the draws the "
        "plan is worth at most so much. Between the first curve and the others lies what doubt costs.",
        (f"Mean values: {told}.",), (context.origin,),
    )  # fmt: skip
    tree = Figure(
        f"robust-tree-{k}", (partial(stability_tree, study.stability),),
        "Every decision of the Bayes-adaptive plan, and how many draws agree with it, each acting on its own "
        "belief about the person after that history. Time runs to the right, help upwards; lines are as wide as "
        "histories are probable; bold frames act.",
        (spoken(study.stability.sentence),), (context.origin,),
    )  # fmt: skip
    return Text(spoken(study.stability.weakest)), tree, curves


def _prices(context: ReportContext, study: RobustStudy, k: int) -> tuple[Block, ...]:
    frame = study.prices.table
    values = {
        "name": "plan", "mean": "mean", "held_out_mean": "mean, held out", "cvar": f"worst {ALPHA:.0%}",
        "held_out_cvar": f"worst {ALPHA:.0%}, held out", "worst": "worst draw",
    }  # fmt: skip
    compared = {
        "name": "plan", "gain_mean": "gain over never", "gain_q05": "from", "gain_q95": "to",
        "gain_probability": "P(gain > 0)", "gain_cvar": f"gain, worst {ALPHA:.0%}", "mean_regret": "mean regret",
        "cvar_regret": f"regret, worst {ALPHA:.0%}", "max_regret": "largest regret",
    }  # fmt: skip
    about = "; ".join(f"{p.name}: {p.about}" for p in study.prices.prices)
    tables = [
        Table(
            f"robust-{key}-{k}", pd.DataFrame(frame[list(shown)]), caption, (context.origin,), headings=shown,
            formats={c: ".2f" if c == "gain_probability" else ",.1f" for c in shown if c != "name"},
        )
        for key, shown, caption in (
            ("plans", values,
             "What plans are worth under doubt. Held out: chosen on one half of the draws and scored on the "
             "other, so that a plan does not profit from the draws it was chosen with. "
             f"{about[0].upper()}{about[1:]}."),
            ("regrets", compared,
             "The same plans draw by draw. Gain: over never helping in the same draw, with the range of the middle "
             "90% of the draws. Regret: against the best plan for the draw, were it known."),
        )
    ]  # fmt: skip
    best = study.prices["Bayes-adaptive"]
    figure = Figure(
        f"robust-comparison-{k}", (partial(plan_comparison, study.prices),),
        f"The same: mean over the draws, mean on held-out draws, mean of the worst {ALPHA:.0%}, worst draw.",
        (f"Bayes-adaptive: mean {best.mean:.4g}, worst {ALPHA:.0%} {best.cvar:.4g}. See the table.",),
        (context.origin,),
    )  # fmt: skip
    listening = (
        f"Listening to responses is worth {study.adaptivity:.3g} over the best fixed sequence of actions; learning "
        f"which draw it faces at most {study.learning:.3g}, over the best plan found for one model."
    )
    return Text(study.prices.sentence), Text(listening), figure, *tables, _what_they_do(study)


def _what_they_do(study: RobustStudy) -> Points:
    """Plans and mixtures of plans, where they act."""
    said = []
    for name in WRITTEN_OUT:
        chosen = study.prices[name].chosen
        mixed = sorted(zip(chosen.plans, chosen.share, strict=True), key=lambda x: -x[1])[:MOST_WRITTEN]
        for plan, share in mixed:
            often = "" if len(chosen.plans) == 1 else f", in {share:.0%} of the cases"
            said.append(spoken(f"{name}{often}: {' · '.join(acting_words(study.schedule, plan))}"))
    return Points(
        tuple(said),
        "Where the plans act, by the responses before (a mixture draws one plan before the first event)",
    )


def _caution(context: ReportContext, study: RobustStudy, k: int) -> tuple[Block, ...]:
    words = [f"At {name}: {found.sentence}" for name, found in study.frontiers.items()]
    plans = [p for f in study.frontiers.values() for p in f.plans]
    gap = max((p.gap for p in plans), default=0.0)
    open_ = sum(not p.certified for p in plans)
    sure = f"{open_} of {len(plans)} points are not certified" if open_ else "Every point is certified"
    words += [spoken(flip.sentence) for flip in study.flips]
    figure = Figure(
        f"robust-caution-{k}", (partial(caution, study.frontiers),),
        "What the best cautious plans gain over the Bayes-adaptive plan in the worst share of the draws, and what "
        f"they give up on average. {_contested_words(study)}{sure}, largest gap {gap:.1g}.",
        (" ".join(words),), (context.origin,),
    )  # fmt: skip
    return Points(tuple(words), "Caution"), figure


def _contested_words(study: RobustStudy) -> str:
    """At which costs the second frontier is, if there is one."""
    modes = [spoken(f.mode) for f in study.together if f.multiple is not None and any(f.costs.values())]
    if not modes:
        return ""
    if len(modes) == 1:
        return f"Contested costs: those at which the first decision of {modes[0]} flips. "
    return f"Contested costs: those at which the first decisions of {' and '.join(modes)} flip together. "


def _next_letters(context: ReportContext, study: RobustStudy) -> str:
    return NEXT if context.is_published_protocol else next_rounds(study.schedule.protocol, rounds_of(context))


def _information(context: ReportContext, study: RobustStudy, k: int) -> tuple[Block, ...]:
    rows = [s for sample in study.samples for s in sample.sentences]
    bars = Figure(
        f"robust-blocks-{k}", (partial(information_by_block, study.partial),),
        "What it would be worth to know one block of the tables for sure, by a rule fitted on some draws and "
        "scored on the others, with standard errors; and all of them together.",
        (study.partial.sentence,), (context.origin,),
    )  # fmt: skip
    curves = Figure(
        f"robust-studies-{k}", (partial(information_by_people, study.samples),),
        f"What further people would be worth, by study, over {_next_letters(context, study)}: expected gain over "
        "today's plan, from simulated data sets; bars are twice the standard error, bands reach down to the "
        "estimate for plans scored on draws that did not choose them, hollow markers leave too few draws to say. "
        "The line above is what perfect knowledge would be worth.",
        (" ".join(rows),), (context.origin,),
    )  # fmt: skip
    shown = {
        "study": "study", "people": "people", "worth": "worth", "se": "standard error", "held_out": "held out",
        "effective": "effective draws", "enough": "draws suffice",
    }  # fmt: skip
    told = [row for sample in study.samples for row in sample.told]
    frame = pd.DataFrame([{c: getattr(row, c) for c in shown} for row in told])
    table = Table(
        f"robust-next-{k}", frame.assign(enough=frame["enough"].map({True: "yes", False: "no"})),
        "What further people would be worth, in reward units a person served, for the largest study of each kind "
        "that these draws can tell of, or the smallest where they can tell of none. Held out: for plans scored on "
        "draws that did not choose them, if anything too low. Effective draws: how many are left after such data; "
        f"below {FEWEST_EFFECTIVE:.0f} they do not suffice to say.",
        (context.origin,), headings=shown,
        formats={"people": ",d", "worth": ".2f", "se": ".2f", "held_out": ".2f", "effective": ",.0f"},
    )  # fmt: skip
    return (
        Text(study.perfect.sentence),
        Text(study.partial.sentence),
        bars,
        *(Text(s.sentence) for s in study.samples),
        table,
        curves,
    )
