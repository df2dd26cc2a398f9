"""What sections that plan ask of a reward: the paper's for its own protocol, else the one stated for the report."""

from __future__ import annotations

from analysis.figures.style import spoken
from analysis.policy_study import STUDY2
from analysis.report.context import ReportContext
from analysis.report.section import NotSupported
from analysis.stated_reward import letters_in_words
from analysis.wording import counted
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.unseen import evidence_of_actions, unseen_actions


def want_reward(context: ReportContext) -> None:
    """Leave a section out where nobody says what a round is worth.

    Raises
    ------
    NotSupported
        With how to say it.
    """
    if context.stated is None and not context.is_published_protocol:
        raise NotSupported(
            f"what a round is worth is not known for protocol {context.protocol.name!r}; `--values` says it "
            "(build_report: reward), one value a state or as measured by the tokens of the data"
        )


def unseen_or_left_out(context: ReportContext) -> tuple[str, ...]:
    """Actions that the data say nothing about, where there still is something to decide.

    Raises
    ------
    NotSupported
        Without evidence on an action that others are compared with, or on any that costs something.
    """
    unseen = unseen_actions(evidence_of_actions(context.log, context.pins), context.protocol)
    null = [m.null_action for m in context.protocol.modes]
    nothing = [a for a in null if a in unseen]
    if nothing:
        words = spoken(nothing[0])
        raise NotSupported(f"the data say nothing about {words}, with which everything else is compared")
    if all(a in unseen for a in context.protocol.action_names if a not in null):
        raise NotSupported(f"the data say nothing about {_either(unseen)}, so there is nothing to decide")
    return unseen


def _either(actions: tuple[str, ...]) -> str:
    names = [spoken(a) for a in actions]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def planned_states(context: ReportContext) -> tuple[int, ...]:
    """Numbers of states that are planned with, largest first: those shown in full, or with a stated reward."""
    chosen = context.shown_states if context.stated is None else context.stated.states
    return tuple(sorted(chosen, reverse=True))


def title_of(context: ReportContext, k: int) -> str:
    """Title of the part on one number of states, and why it is shown."""
    paper = ["the paper's number"] * (k == 4 and context.is_published_protocol)
    why = paper + ["lowest BIC"] * (k == context.study.best_by_bic)
    return counted(k, "state") + (f" ({', '.join(why)})" if why else "")


def rewarded_model(context: ReportContext, k: int) -> LatentStatePOMDP:
    """The fitted model with the reward of this report."""
    model = context.study.fits[k].model
    return model if context.stated is None else context.stated.of_model(model)


def rewarded_draws(context: ReportContext, draws: ModelDraws) -> ModelDraws:
    """Draws with the reward of this report."""
    return draws if context.stated is None else context.stated.of_draws(draws)


def rounds_of(context: ReportContext) -> str:
    """Letters of the rounds that are planned for: the paper's study 2, or those of the data."""
    return STUDY2 if context.stated is None else context.stated.schedule


def rounds_in_words(context: ReportContext) -> str:
    """The same with their number and what the letters stand for.

    As in ``the 9 rounds HRHRHRHRH (H: the human may help)``.
    """
    letters = rounds_of(context)
    return f"the {len(letters)} rounds {letters} ({letters_in_words(context.protocol)})"
