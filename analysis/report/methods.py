"""The paragraph on methods, ready to quote: what was done to these data, with settings and versions."""

from __future__ import annotations

from collections.abc import Collection

from analysis.report.context import ReportContext, versions
from analysis.report.own_reward import planned_states, rounds_of
from analysis.report.section import NotSupported, Origin
from analysis.report.sections import safeguards, sensitivity, sensitivity_own
from analysis.sensitivity import READING_WORDS
from analysis.wording import counted

ARTICLE = "Zahedi et al. (2026, IEEE Robotics and Automation Letters, doi:10.1109/LRA.2026.3668141)"


def methods_paragraph(context: ReportContext, shown: Collection[str] = ()) -> str:
    """What was done, in the words of a methods section.

    Only what this report did is claimed; settings come from the fits themselves.

    Parameters
    ----------
    context : ReportContext
    shown : collection of str
        Keys of all figures and tables: sensitivity and safeguards are named where they are among them.
    """
    log, study = context.log, context.study
    people = counted(log.n_participants, "person", "people")
    kind = {Origin.SIMULATED: "simulated ", Origin.REAL: ""}.get(context.origin, "")
    who = people if not kind else people.replace(" p", f" {kind}p", 1)
    origin = "" if context.origin is not Origin.UNSTATED else " (the file does not state whether they are real)"
    search = next(iter(study.fits.values())).settings
    sizes = list(map(str, study.states))
    states = (
        counted(study.states[0], "state") if len(sizes) == 1 else f"{', '.join(sizes[:-1])} and {sizes[-1]} states"
    )
    sampler = context.effort.sampler(context.seed)
    own = versions()
    pinned = ", ".join(context.pins)
    held = f" The transition table of {pinned} was held fixed at the identity." if pinned else ""
    picked = f" (condition {', '.join(context.conditions)})" if context.conditions else ""
    sizes_shown = [counted(k, "state") for k in context.shown_states]
    sampled = f" For the model with {' and '.join(sizes_shown)} we" if sizes_shown else " We"
    quick = " These are the settings of a quick report, not for citation." if context.effort.quick else ""
    return (
        f"We analysed {counted(log.n_responses_recorded, 'recorded response')} in "
        f"{counted(log.n_runs, 'run')} of {who}{origin}{picked} with the latent-state model of {ARTICLE}: a hidden "
        "Markov model whose transitions depend on the robot's action and whose responses depend on the state "
        f"before the transition. Models with {states} were fitted by Baum-Welch (expectation maximisation "
        f"with monotone extrapolation, {search.restarts} random starts, the best "
        f"{search.finalists or search.restarts} run to a gain below {search.tolerance:g}, seed {search.seed}) and "
        f"compared by AIC, BIC and leave-one-person-out prediction.{held}{sampled} sampled the posterior with the "
        f"No-U-Turn sampler ({sampler.chains} chains of {sampler.draws:,} draws after {sampler.tune:,} of tuning), "
        "the states summed out; priors are Dirichlet with two pseudo-counts on staying in a state. Plans for a "
        "known schedule are exact, by backward induction over all histories; plans without horizon come with upper "
        f"and lower bounds.{_worth(context)}{_depends(context, shown)}{_guarded(context, shown)} "
        f"Analyses were run with the prosocial workbench {own['prosocial-workbench']} (Python "
        f"{own['python']}, numpy {own['numpy']}, numba {own['numba']}, nutpie {own['nutpie']}); the content of the "
        f"data has SHA-256 {context.data.digest[:16]}.{quick}"
    )


def _draws(context: ReportContext) -> int:
    """Draws of each posterior."""
    sampler = context.effort.sampler(context.seed)
    return int(sampler.chains * sampler.draws)


def _worth(context: ReportContext) -> str:
    """Where the reward comes from, if it is not the paper's."""
    if context.stated is None:
        return ""
    how = (
        "measured as the team's mean tokens, rounds weighted by the smoothed probabilities of the states"
        if context.stated.measured
        else "stated by us and not learned"
    )
    worth = "; ".join(
        f"{', '.join(f'{v:.4g}' for v in context.stated.rewards[k].prosocial())} with {counted(k, 'state')}"
        for k in context.stated.states
    )
    return f" What a round is worth in each state was {how} ({worth}, in {context.stated.unit})."


def _depends(context: ReportContext, shown: Collection[str]) -> str:
    """What decisions were asked to depend on, if that is shown."""
    if not any(key.startswith(("sensitivity-shares-", "sensitivity-cost-")) for key in shown):
        return ""
    total, quick = _draws(context), context.effort.quick
    readings = "; ".join(READING_WORDS.values())
    if context.stated is not None:
        endless = sensitivity_own.QUICK_ENDLESS_DRAWS if quick else sensitivity_own.ENDLESS_DRAWS
        few = sensitivity_own.QUICK_FEW_DRAWS if quick else sensitivity_own.FEW_DRAWS
        return (
            " We varied one at a time the costs, the worth of the states, the discount, the initial belief and the "
            f"prior on staying, in three readings ({readings}), each for evenly spaced draws of the posterior "
            f"({min(endless, total):,} without a horizon, {min(few, total):,} otherwise)."
        )
    effort = sensitivity.QUICK if quick else sensitivity.EFFORT
    grid = context.published["sensitivity"]
    r, costs = (", ".join(f"{v:g}" for v in grid[key]) for key in ("r", "cost_help"))
    few_draws = total if effort.few_draws is None else min(effort.few_draws, total)
    few_critical = total if effort.few_critical is None else min(effort.few_critical, total)
    return (
        f" Sensitivity of two decisions was examined over the paper's grid (r in {r}; both costs in {costs}) in "
        f"three readings ({readings}), for the point estimate and for evenly spaced draws of the posterior "
        f"({min(effort.endless_draws, total):,} without a horizon, {few_draws:,} otherwise); where decisions flip "
        f"was found by bisection ({min(effort.endless_critical, total):,} and {few_critical:,} draws), and "
        "discount, scores of the states, initial belief and the prior on staying were varied too."
    )


def _guarded(context: ReportContext, shown: Collection[str]) -> str:
    """Which safeguards were put around policies, if that is shown."""
    if not any(key.startswith("safeguards-table-") for key in shown):
        return ""
    told: dict[str, None] = {}
    unit = "reward units" if context.stated is None else context.stated.unit
    for k in planned_states(context):
        try:
            own = safeguards.limits(context, k)
        except NotSupported:
            continue
        told[
            f"a budget of {own.budget:g} {unit} a person that no history exceeds, minimum influence with a "
            f"tolerance of {own.tolerance:g} {unit} a decision, and confidence at {own.confidence:g}"
        ] = None
    draws = min(safeguards.QUICK_DRAWS if context.effort.quick else safeguards.DRAWS, _draws(context))
    return (
        f" Safeguards ({', or '.join(told)}), each alone and all together, were put around policies over "
        f"{rounds_of(context)} and followed exactly through all histories in {draws:,} evenly spaced draws of the "
        "posterior; influence is the total variation between where people are and where they would be if left "
        "alone, added up over the rounds."
    )
