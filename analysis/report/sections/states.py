"""Section: how many states, by every criterion a point estimate offers, beside the published procedure."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis.em_study import fewest
from analysis.figures.state_number import information_criteria, log_likelihoods, optima
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, Headline, Origin, Question, Table, Text
from analysis.report.sections.states_caveats import SAME_FIT, caveats
from analysis.wording import counted
from models.baum_welch import SAME_OPTIMUM
from models.baum_welch_fit import BaumWelchFit

CLEAR = 6.0
"""By how much the lowest BIC has to lie below the next to be strong evidence (Kass and Raftery 1995)."""


def make(context: ReportContext) -> tuple[Block, ...]:
    """Table and curves of the criteria, and where restarts ended."""
    study = context.study
    lowest_aic = fewest({k: -fit.aic for k, fit in study.fits.items()})
    summary = (
        f"BIC is lowest at {counted(study.best_by_bic, 'state')}, AIC at {counted(lowest_aic, 'state')}, and the "
        f"log-likelihood, the paper's criterion, is highest at {counted(study.best_by_log_likelihood, 'state')} "
        f"(the fewest among those within {SAME_OPTIMUM:g} of the best). The sample size in BIC is the number of "
        f"recorded responses ({context.log.n_responses_recorded:,})."
    )
    capped = [k for k, fit in study.fits.items() if not fit.converged]
    blocks: list[Block] = [Text(summary), *caveats(study)]
    if capped:
        names = " and ".join(counted(k, "state") for k in capped)
        blocks.append(Text(f"The best run did not converge within the cap at {names}.", "warning"))
    blocks += _missed(context)
    blocks += [_criteria(context), _curves(context), Text(study.restarts_sentence), _searches(context)]
    blocks += [_optima(context), _headline(context)]
    return tuple(blocks)


def _printed(context: ReportContext) -> tuple[int, float]:
    em = context.published["em"]
    return int(em["selected_states"]), float(em["log_likelihood_4_states"])


def _criteria(context: ReportContext) -> Table:
    study = context.study
    printed_states, printed_value = _printed(context)
    rows = []
    for k, fit in study.fits.items():
        row: dict[str, object] = {"states": k, "parameters": fit.n_parameters}
        row |= {"edge": study.identifications[k].on_boundary, "aic": fit.aic, "bic": fit.bic}
        row["own"] = fit.log_likelihood
        if study.paper_fits:
            row["procedure"] = study.paper_fits[k].log_likelihood
        if context.is_published_design:
            row["printed"] = printed_value if k == printed_states else None
        rows.append(row)
    frame = pd.DataFrame(rows)
    headings = {
        "parameters": "free parameters", "edge": "of them at 0 or 1", "aic": "AIC", "bic": "BIC",
        "own": "longer search", "procedure": "published procedure", "printed": "other data",
    }  # fmt: skip
    formats = {
        "states": "d", "parameters": "d", "edge": "d", "aic": ".1f", "bic": ".1f", "own": ".2f",
        "procedure": ".2f", "printed": ".2f",
    }  # fmt: skip
    origin: tuple[Origin, ...] = (context.origin,)
    caption = "Criteria by number of states. AIC and BIC are those of the longer search and better when lower."
    if context.is_published_design:
        origin = (context.origin, Origin.PRINTED)
        caption += " The printed value is of other people."
    return Table(
        "criteria", frame, caption, origin,
        headings={k: v for k, v in headings.items() if k in frame.columns},
        formats={k: v for k, v in formats.items() if k in frame.columns},
        printed=("printed",) if context.is_published_design else (),
        groups=(("", 5), ("log-likelihood (nats)", len(frame.columns) - 5)),
    )  # fmt: skip


def _searches(context: ReportContext) -> Table:
    study = context.study
    rows = []
    for k, fit in study.fits.items():
        row: dict[str, object] = {"states": k, **_search(fit, "own")}
        if study.paper_fits:
            row |= _search(study.paper_fits[k], "procedure")
        rows.append(row)
    frame = pd.DataFrame(rows)
    words = {
        "converged": "best run converged", "best": "runs at the best", "gap": "gap to the next",
        "capped": "runs stopped by the cap",
    }  # fmt: skip
    columns = [c for c in frame.columns if c != "states"]
    groups = [("", 1), ("longer search", 4)]
    if study.paper_fits:
        groups.append(("published procedure", 4))
    caption = (
        "How sure each search is of its maximum. Runs at the best ended within 0.01 of it; the gap, in nats, is to "
        "the next optimum."
    )
    return Table(
        "searches", frame, caption, (context.origin,), headings={c: words[c.split()[1]] for c in columns},
        formats={"states": "d", **{c: ".2f" for c in columns if c.endswith("gap")}}, groups=tuple(groups),
    )  # fmt: skip


def _search(fit: BaumWelchFit, prefix: str) -> dict[str, object]:
    total = fit.runs_in_final_stage
    return {
        f"{prefix} converged": fit.converged,
        f"{prefix} best": f"{fit.optima[0].restarts} of {total}",
        f"{prefix} gap": fit.gap_to_second,
        f"{prefix} capped": f"{total - sum(o.converged for o in fit.optima)} of {total}",
    }


def _missed(context: ReportContext) -> list[Block]:
    """Warn where the shown model is demonstrably not the maximum."""
    study = context.study
    out: list[Block] = []
    for k, paper in study.paper_fits.items():
        own = study.fits[k].log_likelihood
        if paper.log_likelihood > own + SAME_OPTIMUM:
            out.append(
                Text(
                    f"At {counted(k, 'state')} the published procedure found {paper.log_likelihood:.2f}, better "
                    f"than the {own:.2f} of the longer search: the model shown for {counted(k, 'state')} is not "
                    "the maximum.",
                    "warning",
                )
            )
    return out


def _curves(context: ReportContext) -> Figure:
    study = context.study
    own = {k: fit.log_likelihood for k, fit in study.fits.items()}
    paper = {k: fit.log_likelihood for k, fit in study.paper_fits.items()}
    bic = {k: fit.bic for k, fit in study.fits.items()}
    aic = {k: fit.aic for k, fit in study.fits.items()}
    printed = _printed(context) if context.is_published_design else None
    caption = (
        "Left: log-likelihood by number of states. It cannot fall as states are added when the search finds the "
        "maximum. Right: the criteria that charge for parameters, the lowest circled."
    )
    origin: tuple[Origin, ...] = (context.origin,)
    if printed:
        caption += (
            " The star is the number printed in the paper, of other data: level with this study only by design."
        )
        origin = (context.origin, Origin.PRINTED)
    alt_ll = "Log-likelihood of the longer search: " + _listed(own, ".1f")
    if paper:
        alt_ll += "; of the published procedure: " + _listed(paper, ".1f")
    if printed:
        alt_ll += f"; printed in the paper: {printed[1]:.2f} at {printed[0]} states"
    alt_ic = f"BIC: {_listed(bic, '.1f')}; AIC: {_listed(aic, '.1f')}"
    panels = (partial(log_likelihoods, own, paper, printed), partial(information_criteria, bic, aic))
    return Figure("criteria-by-states", panels, caption, (f"{alt_ll}.", f"{alt_ic}."), origin)


def _listed(values: dict[int, float], spec: str) -> str:
    return ", ".join(f"{value:{spec}} at {k}" for k, value in values.items())


def _optima(context: ReportContext) -> Figure:
    study = context.study
    pairs = [(fit, study.paper_fits.get(k)) for k, fit in study.fits.items() if k > 1] or [
        (fit, study.paper_fits.get(k)) for k, fit in study.fits.items()
    ]
    alt = []
    for fit, paper in pairs:
        text = f"{counted(fit.n_states, 'state')}: {fit.optima[0].restarts} of {fit.runs_in_final_stage}"
        text += f" {_runs(fit)} at the best"
        if paper is not None:
            reached = sum(o.restarts for o in paper.optima if fit.log_likelihood - o.log_likelihood <= 0.01)
            text += f"; {reached} of {paper.runs_in_final_stage} restarts of the published procedure reach it"
        alt.append(f"{text}.")
    caption = (
        "Where the restarts ended, below the best log-likelihood found by either search: bars above the line are "
        f"the {_runs(pairs[0][0])} of the longer search, hatched bars below it the restarts of the published "
        "procedure."
    )
    return Figure("optima", tuple(partial(optima, *pair) for pair in pairs), caption, tuple(alt), (context.origin,))


def _runs(fit: BaumWelchFit) -> str:
    """What the runs that were taken to the end are called: all restarts, or those a screening stage let through."""
    return "restarts" if fit.settings.finalists is None else "finalists"


def _headline(context: ReportContext) -> Headline:
    """The choice by BIC with its lead over the next; open unless AIC chooses the same and the lead is clear."""
    study = context.study
    bic = dict(sorted(((k, fit.bic) for k, fit in study.fits.items()), key=lambda entry: entry[1]))
    likelihood = [fit.log_likelihood for fit in study.fits.values()]
    aic = fewest({k: -fit.aic for k, fit in study.fits.items()})
    best, open_ = study.best_by_bic, True
    if len(bic) == 1:
        text = f"Only models with {counted(best, 'state')} were fitted, so nothing is said of their number."
    elif max(likelihood) - min(likelihood) <= SAME_FIT:
        text = (
            f"The likelihood does not tell {' from '.join(map(str, study.states))} states: they lie within "
            f"{max(likelihood) - min(likelihood):.2g} nats, so BIC, lowest at {best}, merely counts parameters."
        )
    else:
        lead, second = min((value - bic[best], k) for k, value in bic.items() if k != best)
        text = (
            f"BIC is lowest at {counted(best, 'state')}, by {lead:.1f} before {second}; AIC at {aic}; the "
            f"log-likelihood, the paper's criterion, at {study.best_by_log_likelihood}."
        )
        open_ = aic != best or lead < CLEAR
        if open_:
            text += " These criteria do not settle the number."
    missed = [k for k, fit in study.fits.items() if not fit.converged]
    if missed:
        text += f" Baum-Welch did NOT converge at {' and '.join(map(str, missed))}."
    kind = "warning" if missed else "open" if open_ else "plain"
    return Headline(text=text, kind=kind, question=Question.STATES, origin=(context.origin,))
