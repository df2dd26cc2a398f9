"""The point estimates behind a report: every number of states, the published procedure beside, bootstraps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from analysis.em_study import EmStudy, Progress, run_em
from analysis.report.effort import Effort
from models.bootstrap import bootstrap_fit
from models.events import EventLog
from models.parameters import Array


def fit_models(
    log: EventLog,
    states: Sequence[int],
    effort: Effort,
    *,
    pins: Mapping[str, Array | None],
    seed: int,
    progress: Progress | None = None,
) -> EmStudy:
    """Fit every number of states, the published procedure beside, and bootstrap what is shown in full."""
    study = run_em(
        log, states, settings=lambda k: effort.search(k, pins, seed), pins=pins, seed=seed, with_paper=True,
        progress=progress,
    )  # fmt: skip
    bootstraps = {}
    for k in study.states:
        if k not in (4, study.best_by_bic):
            continue

        def tell(done: int, total: int, k: int = k) -> None:
            if progress is not None:
                progress(f"bootstrap, {k} states", done, total)

        bootstraps[k] = bootstrap_fit(
            effort.for_bootstrap(study.fits[k]), log, effort.replicates_for(log, k), seed=seed, progress=tell
        )
    return replace(study, bootstraps=bootstraps)
