"""The paragraph on methods, ready to quote: what was done to these data, with settings and versions."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from analysis.comparison_words import listed
from analysis.report.compared_models import scope
from analysis.report.context import ReportContext, versions
from analysis.report.own_reward import planned_states, rounds_of
from analysis.report.search_words import sizes
from analysis.report.section import NotSupported, Origin
from analysis.report.sections import comparison, safeguards, sensitivity, sensitivity_own
from analysis.sensitivity import READING_WORDS
from analysis.wording import counted
from models.glmm import DEFAULT_NODES

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
    log = context.log
    people = counted(log.n_participants, "person", "people")
    kind = {Origin.SIMULATED: "simulated ", Origin.REAL: ""}.get(context.origin, "")
    who = people if not kind else people.replace(" p", f" {kind}p", 1)
    origin = "" if context.origin is not Origin.UNSTATED else " (the file does not state whether they are real)"
    own = versions()
    pinned = ", ".join(context.pins)
    held = f" The transition table of {pinned} was held fixed at the identity." if pinned else ""
    picked = f" (condition {', '.join(context.conditions)})" if context.conditions else ""
    quick = " These are the settings of a quick report, not for citation." if context.effort.quick else ""
    return (
        f"We analysed {counted(log.n_responses_recorded, 'recorded response')} in "
        f"{counted(log.n_runs, 'run')} of {who}{origin}{picked} with the latent-state model of {ARTICLE}: a hidden "
        "Markov model whose transitions depend on the robot's action and whose responses depend on the state "
        f"before the transition. {_fitted(context, shown)}{held}{_sampled(context, shown)}"
        f"{_compared(context, shown)}{_tested(shown)}{_planned(shown)}{_worth(context)}{_depends(context, shown)}"
        f"{_guarded(context, shown)} "
        f"Analyses were run with the prosocial workbench {own['prosocial-workbench']} (Python "
        f"{own['python']}, numpy {own['numpy']}, numba {own['numba']}, nutpie {own['nutpie']}); the content of the "
        f"data has SHA-256 {context.data.digest[:16]}.{quick}"
    )


def _any(shown: Collection[str], *starts: str) -> bool:
    return any(key.startswith(starts) for key in shown)


def _fitted(context: ReportContext, shown: Collection[str]) -> str:
    """The point estimates: search, criteria, bootstrap, with the settings of each fit."""
    searches: dict[str, list[int]] = {}
    for k, fit in context.study.fits.items():
        search = fit.settings
        on = "all" if search.finalists is None else f"{fit.runs_in_final_stage} of them"
        end = f"run on to convergence (a gain below {search.tolerance:g}; at most {search.max_maps:,} maps)"
        words = f"{fit.restarts} random starts, {on} {end}, seed {search.seed}"
        searches.setdefault(words, []).append(k)
    told = "; ".join(f"{sizes(ks)}: {words}" for words, ks in searches.items())
    text = f"Baum-Welch (expectation maximisation with monotone extrapolation) fitted models ({told})."
    if "criteria" in shown and len(context.study.fits) > 1:
        text += " They were compared by log-likelihood, AIC and BIC."
    replicates: dict[tuple[str, int], list[int]] = {}
    for k, boot in context.study.bootstraps.items():
        replicates.setdefault((boot.kind, len(boot.log_likelihood)), []).append(k)
    for (kind, n), ks in replicates.items():
        text += f" Their uncertainty at {sizes(ks)} is that of a {kind} ({counted(n, 'replicate')})."
    return text


def _numbers(numbers: Sequence[int]) -> str:
    return listed([str(k) for k in numbers], "and")


def _sampled(context: ReportContext, shown: Collection[str]) -> str:
    """The posterior, if anything shown rests on it."""
    estimates = _any(shown, "contraction-", "posterior-", "robust-")
    decisions = _any(shown, "sensitivity-shares-", "sensitivity-cost-", "safeguards-table-")
    if not context.shown_states or not (estimates or decisions):
        return ""
    sampler = context.effort.sampler(context.seed)
    text = (
        f" At {sizes(context.shown_states)} we sampled the posterior with the No-U-Turn sampler ({sampler.chains} "
        f"chains of {sampler.draws:,} draws after {sampler.tune:,} of tuning), the states summed out; priors are "
        "Dirichlet with two pseudo-counts on staying in a state."
    )
    if _any(shown, "checks-"):
        text += " The model was checked by comparing the data with studies simulated from the posterior."
    return text


def _compared(context: ReportContext, shown: Collection[str]) -> str:
    """Which models were compared by whom they predict, if that is shown."""
    if "comparison-loo" not in shown:
        return ""
    compared, sampler = scope(context), context.effort.sampler(context.seed)
    models = [f"latent-state models ({sizes(compared.sizes)})"] if compared.sizes else []
    models += ["one state", "first-order Markov dependence on the last response"]
    models.append(f"{_numbers(compared.types)} types of people who never change")
    for k in compared.differing:
        models.append(
            f"people with an intercept of their own {f'beside {sizes((k,))}' if k > 1 else 'and no state'}"
        )
    text = (
        f" We compared {listed(models, 'and')} by leave-one-person-out cross-validation (Pareto-smoothed "
        f"importance sampling; {sampler.chains} chains of {sampler.draws:,} draws each; differences by person)."
    )
    if "comparison-checks" in shown:
        text += (
            f" As far as cost allowed, {comparison.FOLDS}-fold cross-validation over people and the marginal "
            "likelihood by sequential Monte Carlo were added."
        )
    return text


def _tested(shown: Collection[str]) -> str:
    """Regression and analysis of variance, if they are shown."""
    text = ""
    if "regression-models" in shown:
        text += (
            " Responses were regressed on the robot's actions by logistic mixed models with a random intercept for "
            f"each person (adaptive Gauss-Hermite quadrature, {DEFAULT_NODES} nodes)."
        )
    if "anova-table" in shown:
        text += " Shares of help were compared between conditions by analysis of variance."
    if _any(shown, "study2-anova"):
        text += " The paper's second study was simulated again in a game like its own and tested as it was there."
    return text


def _planned(shown: Collection[str]) -> str:
    """What plans are, if they are shown."""
    text = ""
    if _any(shown, "plan-values-"):
        text += " Plans for a known schedule are exact, by backward induction over all histories."
    if _any(shown, "plan-endless-", "robust-endless"):
        text += " Plans without horizon come with upper and lower bounds."
    return text


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
