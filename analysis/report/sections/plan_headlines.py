"""What the robot should do, in one sentence: by plans under doubt, or by the point estimate alone."""

from __future__ import annotations

from analysis.figures.style import spoken
from analysis.learned_policy import LearnedPolicy
from analysis.policy_study import LEARNED, OPTIMAL
from analysis.randomised_arms import answering
from analysis.report.context import ReportContext
from analysis.report.section import Headline, Question
from analysis.robust_study import RobustStudy
from analysis.wording import counted
from models.gate import Gate
from models.robust.information import SAME


def under_doubt(context: ReportContext, study: RobustStudy, gate: Gate) -> Headline:
    """The plan that is best under doubt: how often it acts, and what it gains over never acting.

    Whether acting pays is open where the gain of the middle 90% of the draws holds zero.

    Parameters
    ----------
    context : ReportContext
    study : RobustStudy
    gate : Gate
        Of the posterior whose draws were planned for.
    """
    best, same = study.prices["Bayes-adaptive"], study.prices.best_baseline
    unit, low, high = study.schedule.unit, best.gain_q05, best.gain_q95
    rounding, open_ = SAME * max(1.0, abs(best.mean)), False
    text = f"By {_reward(context)} over {counted(study.schedule.n_events, 'round')} "
    if max(abs(best.gain_mean), abs(low), abs(high)) <= rounding:
        text += (
            f"no plan is better on average over the draws than never acting, worth {best.mean:.4g} {unit} a person "
            f"({best.cvar:.4g} in the worst {study.alpha:.0%} of the draws)."
        )
    else:
        open_ = low <= rounding
        name = f"the best plan under doubt, '{spoken(same)}'," if same else "the best plan under doubt"
        least = study.stability.least_sure
        text += (
            f"{name} {_acts(study)} (its least sure decision has {least.share[least.action]:.0%} of the draws) and "
            f"gains {best.gain_mean:.3g} {unit} a person over never acting (90% of the draws: {low:.3g} to "
            f"{high:.3g})."
        )
        text += " Whether acting pays is not decidable." if open_ else ""
    if answering(context.log):
        open_ = True
        text += " NOT RANDOMISED, so no gain is an effect of acting."
    text += "" if gate.passed else " The convergence gate FAILED."
    kind = "warning" if not gate.passed else "open" if open_ else "plain"
    return Headline(
        text=text, kind=kind, question=Question.PLAN, origin=(context.origin,),
        about=counted(study.schedule.n_states, "state"),
    )  # fmt: skip


def by_estimate(context: ReportContext, learned: LearnedPolicy, k: int) -> Headline:
    """The plan of the point estimate, which has no doubt: only its distance from the baselines, and to the truth.

    Parameters
    ----------
    context : ReportContext
    learned : LearnedPolicy
    k : int
        Number of states.
    """
    study = learned.study
    rest = {name: v.value for name, v in study.values.items() if name not in (OPTIMAL, LEARNED)}
    winner = max(rest, key=lambda name: rest[name])
    text = (
        f"By {_reward(context)} over {counted(study.plan.schedule.n_events, 'round')} the best plan is worth "
        f"{study.plan.value:.4g} {study.plan.schedule.unit} a person if the learned tables are true, the best "
        f"baseline, {winner}, {rest[winner]:.4g}"
    )
    if learned.in_truth is not None:
        own, best = (learned.in_truth.values[name].value for name in (LEARNED, OPTIMAL))
        text += f"; in the truth behind these people it is worth {own:.4g} of {best:.4g}"
    text += ". A point estimate: how sure that is, is not said here."
    observed = bool(answering(context.log))
    text += " NOT RANDOMISED, so no gain is an effect of acting." if observed else ""
    converged = context.study.fits[k].converged
    if not converged:
        text += " Baum-Welch did NOT converge."
    return Headline(
        text=text, kind="warning" if not converged else "open" if observed else "plain",
        question=Question.PLAN, origin=(context.origin,),
        about=counted(k, "state"),
    )  # fmt: skip


def _acts(study: RobustStudy) -> str:
    """How often the best plan under doubt takes each action that is not its mode's null action, on average."""
    null = {mode.null_action for mode in study.schedule.protocol.modes}
    often: dict[str, float] = {
        action.name: 0.0
        for mode in study.schedule.protocol.modes for action in mode.actions if action.name not in null
    }  # fmt: skip
    for standing in study.stability.standings:
        if standing.action in often:
            often[standing.action] += standing.probability
    return f"takes {' and '.join(f"'{spoken(name)}' {n:.1f} times" for name, n in often.items())}"


def _reward(context: ReportContext) -> str:
    """Whose reward the values are in; data of people who played for something else say so on their card."""
    if context.stated is not None:
        return "the reward stated"
    other = " (these people played for something else)" if context.data.card.stakes else ""
    return f"the paper's token reward{other}"
