"""The paragraph on methods, ready to quote: what was done to these data, with settings and versions."""

from __future__ import annotations

from analysis.report.context import ReportContext, versions
from analysis.report.section import Origin
from analysis.wording import counted

ARTICLE = "Zahedi et al. (2026, IEEE Robotics and Automation Letters, doi:10.1109/LRA.2026.3668141)"


def methods_paragraph(context: ReportContext) -> str:
    """What was done, in the words of a methods section.

    Only what this report did is claimed; settings come from the fits themselves.
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
    shown = [counted(k, "state") for k in context.shown_states]
    sampled = f" For the model with {' and '.join(shown)} we" if shown else " We"
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
        f"and lower bounds. Analyses were run with the prosocial workbench {own['prosocial-workbench']} (Python "
        f"{own['python']}, numpy {own['numpy']}, numba {own['numba']}, nutpie {own['nutpie']}); the content of the "
        f"data has SHA-256 {context.data.digest[:16]}.{quick}"
    )
