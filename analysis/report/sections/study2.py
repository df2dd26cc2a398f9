"""Section: study 2 in the token game, and its tests beside the printed ones."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from analysis import study2_beliefs
from analysis.figures.study2 import four_panels
from analysis.printed_study2 import anova_beside, comparisons_beside, implied_sentence
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, NotSupported, Origin, Part, Points, Table, Text, attempt
from analysis.report.sections.plan import known_truth
from analysis.report.sections.study2_again import again_blocks
from analysis.report.sections.study2_game import game_blocks
from analysis.report.stored import stored
from analysis.study2 import Study2, run_study2
from analysis.study2_analysis import Study2Analysis, analyse
from analysis.study2_beliefs import SCALE, belief_spread
from analysis.study2_claims import as_printed
from analysis.study2_learning import posterior_notes
from analysis.study2_outcomes import (
    BELIEF,
    CUMULATIVE,
    OBSERVED,
    OUTCOMES,
    SHORT,
    TEAM,
    by_round,
    means,
    relative_to,
)
from analysis.study2_policies import LS_POMDP, MORE, NEVER, PAPER, Learned, make_policies
from analysis.wording import counted
from models.unseen import evidence_of_actions, unseen_actions

SIMULATED = (Origin.SIMULATED,)
BESIDE = (Origin.SIMULATED, Origin.PRINTED)

PAPER_STATES = 4

DIGITS = {TEAM: "+.2f", CUMULATIVE: "+.1f", BELIEF: "+.2f", OBSERVED: "+.3f"}
"""Of differences between policies."""

CAUTIONS = (
    "These people are drawn from a model with states. That a policy does well with them says nothing about people "
    "who do not follow such a model.",
    "The truth was calibrated to study 1's printed statistics, and nothing to study 2's. Where the paper's "
    "conclusions do not come out, this truth, the game's unprinted rules or the paper may be the reason.",
    "Tokens come from the game: a person or robot that stays trapped collects none. The reward that policies are "
    "planned with counts states and costs, not tokens, so more tokens are not more reward.",
    SCALE,
    "A conclusion that comes out in most studies is one that such a study would find, not one that is true.",
)


def make(context: ReportContext) -> tuple[Block, ...]:
    """One simulated study beside the printed one, then stored replicates."""
    if not context.is_published_protocol:
        raise NotSupported(f"the game plays the published rounds, and these are of {context.protocol.name!r}")
    if set(context.log.conditions) != set(context.published["study1"]["conditions"]):
        raise NotSupported("study 2 followed the published study 1, and this study has other conditions")
    study = context.published["study2"]
    intro = (
        f"Study 2 put {study['participants']} people under {len(study['policies'])} policies for {study['rounds']} "
        f"rounds ({study['sequence']}; H: the human may help). Here it is run again with SIMULATED people, in a "
        "token game made from the paper's description. In each round the robot acts on what it believes, the "
        "person's hidden state moves by a known truth, willingness to help is drawn from that state, and the round "
        "is played; what the robot sees is whether the person came."
    )
    one = attempt("one simulated study", partial(_one, context))
    measured = stored("game", game_blocks, "the game beside the paper's numbers")
    again = stored("study2", again_blocks, "replicates of study 2")
    return (
        Text(intro),
        Text(context.kept("what printed tests imply", implied_sentence, context.published)),
        Part("Is it the paper's game?", "study2-game", measured),
        Part("One simulated study", "study2-one", one),
        Part("How often do the paper's conclusions come out?", "study2-again", again),
        Points(CAUTIONS, "What not to conclude"),
    )


# -- one study -------------------------------------------------------------------------------------
def _one(context: ReportContext) -> tuple[Block, ...]:
    truth = known_truth(context)
    if truth is None:
        raise NotSupported("people can be simulated where the truth behind the data is known, and here it is not")
    fits = context.study.fits
    k = PAPER_STATES if PAPER_STATES in fits else context.study.best_by_bic
    unseen = unseen_actions(evidence_of_actions(context.log, context.pins), context.protocol)
    if k == 1 or unseen:
        raise NotSupported(
            "a robot that believes in one state never acts" if k == 1
            else f"the data say nothing about {', '.join(unseen)}, which policies of the study do"
        )  # fmt: skip
    posterior = context.posterior(k)
    words = (
        f"the Baum-Welch estimate with {counted(k, 'state')} on the people of this report (log-likelihood "
        f"{fits[k].log_likelihood:.3f})"
    )
    learned = Learned(
        fits[k].model, posterior.draws(), words, posterior_notes(posterior), fits[k], context.log
    )  # fmt: skip
    each = context.published["study2"]["participants"] // len(PAPER)

    def played() -> tuple[Study2, Study2Analysis, str]:
        made = make_policies(learned, PAPER + MORE)
        everybody = run_study2(made, truth, learned, each * len(made.policies), seed=context.seed)
        study = as_printed(everybody)
        return everybody, analyse(study), belief_spread(study, learned).sentence

    everybody, found, spread = context.kept_from(
        "one simulated study 2", played, run_study2,
        {"learned": learned, "truth": truth, "names": PAPER + MORE, "each": each, "seed": context.seed,
         "searches": study2_beliefs.SEARCHES},
        modules=[f.__module__ for f in (make_policies, analyse, as_printed, belief_spread)],
    )  # fmt: skip
    study = as_printed(everybody)
    blocks: list[Block] = [
        Text(
            f"The robot's model is {words}, with its posterior for the planners that reckon with doubt; people "
            f"follow the truth behind them. {counted(each, 'person', 'people')} a policy, seed {context.seed}. "
            f"Tests are of the paper's {len(PAPER)} policies."
        )
    ]
    blocks += [Text(note, "warning") for note in everybody.notes]
    if everybody.missed:
        blocks.append(
            Text(f"{counted(everybody.missed, 'willing person', 'willing people')} came too late to help.", "note")
        )
    blocks.append(_panels("study2-panels", study, PAPER, "the paper's policies"))
    blocks += [Text(_swings(study)), *(Text(sentence) for sentence in found.sentences)]
    blocks.append(Text(spread))
    blocks += [_means(everybody), *_beside(context, found), *_help(found)]
    more = (LS_POMDP, NEVER, *MORE)
    blocks.append(_panels("study2-panels-more", everybody, more, "planners that the paper did not have"))
    return tuple(blocks)


def _panels(key: str, study: Study2, policies: tuple[str, ...], whose: str) -> Figure:
    panels, alt = [], []
    for outcome, title in (
        (TEAM, "Team performance"), (CUMULATIVE, "Cumulative tokens, less never"),
        (BELIEF, "Believed state"), (OBSERVED, "Observed help"),
    ):  # fmt: skip
        own = OUTCOMES[outcome]
        table = relative_to(study, outcome) if outcome == CUMULATIVE else by_round(study, outcome)
        table = table[table["policy"].isin(policies)]
        table = table.assign(policy=pd.Categorical(table["policy"], policies)).sort_values(["policy", "round"])
        label = "tokens so far, less never" if outcome == CUMULATIVE else own.unit
        panels.append((title, label, table.astype({"policy": str})))
        last = table[table["round"] == table["round"].max()]
        told = ", ".join(f"{r.policy} {r.mean:.3g}" for r in last.itertuples())
        alt.append(f"{title} in the last round: {told}.")
    return Figure(
        key, (partial(four_panels, tuple(panels), study.letters),),
        f"Outcomes over the rounds, {whose}: means with 95% intervals (t; Wilson for observed help; cumulative "
        "tokens as differences from never, Welch, as the paper draws them). Believed state: expected index of the "
        "state by the robot's belief after the round, 0 the least prosocial.",
        (" ".join(alt),), SIMULATED,
    )  # fmt: skip


def _swings(study: Study2) -> str:
    """How far beliefs move from round to round, beside the people they are about."""
    index = np.arange(study.truth.n_states)
    own = study.of(LS_POMDP)
    true = np.array(
        [(study.state[own, k + 1][:, None] == index).mean(axis=0) @ index for k in range(study.n_rounds)]
    )
    believed = study.believed_state[own].mean(axis=0)
    moved, real = (float(np.abs(np.diff(path)).mean()) for path in (believed, true))
    text = (
        f"Under {LS_POMDP} the mean belief moves by {moved:.2f} states from one round to the next, people's true "
        f"mean state by {real:.2f}."
    )
    if moved > 2 * real:
        text += (
            " A rise of such a belief is no rise of prosociality: people have not moved that far. Learned tables "
            "in which each action sends people to states of its own would make beliefs swing so; whether these do "
            "is not computed here."
        )
    return text


def _means(study: Study2) -> Table:
    table = means(study)
    names = SHORT | {
        "top_state_probability": "P(most prosocial)", "costly_actions": "costly actions", "reward": "reward"
    }  # fmt: skip
    wide = table.pivot_table(index="policy", columns="outcome", values="mean").loc[
        list(study.policies), list(names)
    ]
    formats = {TEAM: ".2f", CUMULATIVE: ".1f", BELIEF: ".2f", "top_state_probability": ".2f", OBSERVED: ".3f",
               "costly_actions": ".2f", "reward": ",.1f"}  # fmt: skip
    return Table(
        "study2-means", wide.reset_index(),
        "Means over the people of each policy: believed state and probability, both on the robot's own scale, over "
        "all rounds; reward by the true states and the published reward, summed over the rounds.",
        SIMULATED, headings=names, formats=formats,
    )  # fmt: skip


def _beside(context: ReportContext, found: Study2Analysis) -> tuple[Block, ...]:
    frame = anova_beside(found, context.published)
    df2 = int(frame["df2"].iloc[0])
    anova = Table(
        "study2-anova", frame[["outcome", "effect", "simulated_f", "simulated_p", "printed_f", "printed_p"]],
        "Mixed analyses of variance, first against last round that measures the outcome: simulated beside printed. "
        "A printed p of 0 stands for p < .001; the paper tests no beliefs, and those of the robot are on its own "
        f"scale. Residual degrees of freedom: {df2}.",
        BESIDE, row_headings=2, printed=("printed_f", "printed_p"),
        headings={"simulated_f": "F", "simulated_p": "p", "printed_f": "F", "printed_p": "p"},
        formats={"simulated_f": ",.2f", "simulated_p": ".2g", "printed_f": ",.2f", "printed_p": ".4g"},
        groups=(("", 2), ("simulated", 2), ("printed", 2)),
    )  # fmt: skip
    return anova, *_compared(context, found)


def _compared(context: ReportContext, found: Study2Analysis) -> tuple[Table, ...]:
    """One table an outcome: each has its own digits, and fits a narrow page."""
    pairs = comparisons_beside(found, context.published)
    heads = {
        "simulated_difference": "difference", "simulated_low": "from", "simulated_high": "to",
        "simulated_p": "p, Tukey", "simulated_dunnett": "p, Dunnett", "printed_difference": "difference",
        "printed_p": "p, Tukey",
    }  # fmt: skip
    out = []
    for key, tukey in found.tukey.items():
        own = pairs[pairs["outcome"] == tukey.what].drop(columns="outcome")
        is_printed = bool(own["printed_difference"].notna().any())
        if not is_printed:
            own = own.drop(columns=["printed_difference", "printed_p"])
        shown = [name for name in heads if name in own.columns]
        beside = (
            "simulated beside printed. A printed p of 0 stands for p < .001"
            if is_printed
            else "simulated; the paper prints none"
        )
        scale = ", on the robot's own scale" if key == BELIEF else ""
        out.append(
            Table(
                f"study2-tukey-{key.replace('_', '-')}", own,
                f"{tukey.what[:1].upper()}{tukey.what[1:]}: mean under each policy less mean under "
                f"{found.reference}, one value a person{scale}: {beside}. Intervals are Tukey's, for all pairs "
                "together.",
                BESIDE if is_printed else SIMULATED, headings={name: heads[name] for name in shown},
                printed=("printed_difference", "printed_p") if is_printed else (),
                formats={n: ".2g" if "_p" in n or "dunnett" in n else DIGITS[key] for n in shown},
                groups=(("", 1), ("simulated", 5), *((("printed", 2),) if is_printed else ())),
            )
        )  # fmt: skip
    return tuple(out)


def _help(found: Study2Analysis) -> tuple[Block, ...]:
    blocks: list[Block] = []
    model = found.help_model
    if model is not None:
        blocks.append(Text(model.sentence))
        blocks += [Text(note, "note") for note in model.notes]
        odds = model.odds
        blocks.append(
            Table(
                "study2-odds", odds,
                f"Observed help, logistic mixed model of all responses: odds under a policy over those under "
                f"{model.reference}, for the same person half-way through the study, and how much faster they grow "
                "from first to last round. 95% Wald intervals.", SIMULATED,
                headings={"odds_ratio": "odds ratio", "low": "from", "high": "to", "growth": "growth",
                          "growth_low": "from", "growth_high": "to"},
                formats=dict.fromkeys(odds.columns.drop("policy"), ".3g"),
            )
        )  # fmt: skip
    if found.twin is not None:
        blocks.append(
            Table(
                "study2-logistic", found.twin.table[["effect", "chi_squared", "df", "p"]],
                f"{found.twin.title}, first and last round that shows a response: the test beside the analysis of "
                "variance of observed help.", SIMULATED, headings={"chi_squared": "χ²"},
                formats={"chi_squared": ".2f", "df": "d", "p": ".2g"},
            )
        )  # fmt: skip
        blocks += [Text(note, "note") for note in found.twin.notes]
    return tuple(blocks)
