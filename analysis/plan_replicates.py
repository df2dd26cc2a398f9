r"""Do plans that reckon with doubt do better in truth? A simulation that could refute it.

Truths are drawn from the prior, study 1 is simulated in each, and everything is learned from that study alone:
the posterior and the Baum-Welch estimate. The plans made of them are then valued in the truth, exactly. The claims
under test are that the Bayes-adaptive plan is worth at least as much on average as the plan of the point estimate,
and that cautious plans are worth more in the lower tail, over truths. What comes out is reported as found.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import CancelledError, Executor
from dataclasses import dataclass, field
from threading import Event
from typing import Any

import numpy as np

from analysis.recovery_quantities import of_truth
from analysis.replicates import Progress, prior_draw, run_replicates, simulated_study
from models.baum_welch import BaumWelch
from models.bayesian_fit import fit
from models.errors import located
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.nuts import Chain, NutsSettings
from models.parameters import STICKY, Array, DirichletPrior, Layout
from models.planning.baselines import always, never
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import Decisions, solve_schedule
from models.planning.policies import Policy
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.robust.candidates import posterior_mean
from models.robust.cautious import cautious_plan
from models.robust.contested import contested, with_costs
from models.robust.own_plans import own_plans
from models.robust.plan_table import PlanEvaluator
from models.robust.risk import RiskSet, cvar

STREAM = 7_205
"""First element of the spawn keys; number of states and replicate follow."""

BAYES, PLUG_IN, CAUTIOUS = "Bayes-adaptive", "plug-in EM", "cautious"

SETTINGS = ("published costs", "contested costs")
"""The published costs, and those at which the first decisions flip by what is believed after the study."""

BOOTSTRAP = 4_000
"""Resampled sets of truths behind an interval of a difference in the tail."""


@dataclass(frozen=True)
class PlanReplicates:
    """One such simulation.

    Attributes
    ----------
    states : int
        Of truths and of what is fitted.
    replicates, participants : int
    schedule : str
    alpha : float
        Level of the cautious plan, and share of the truths that counts as the lower tail.
    prior : DirichletPrior
    sampler : NutsSettings
        Its seed is not used: every replicate has its own.
    restarts : int
        Of Baum-Welch.
    seed : int
    """

    states: int = 2
    replicates: int = 200
    participants: int = 540
    schedule: str = "HRHRHRHRH"
    alpha: float = 0.1
    prior: DirichletPrior = STICKY
    sampler: NutsSettings = field(default_factory=lambda: NutsSettings())
    restarts: int = 60
    seed: int = 1

    def __post_init__(self) -> None:
        for name, low in (("states", 1), ("replicates", 2), ("participants", 1), ("restarts", 1), ("seed", 0)):
            if getattr(self, name) < low:
                raise located(f"replicates of plans, {name}", getattr(self, name), f"an integer of at least {low}")
        if not 0 < self.alpha <= 1:
            raise located("replicates of plans, alpha", self.alpha, "a share above 0 and up to 1")


@dataclass(frozen=True)
class PlansInTruth:
    """One replicate: what each plan is worth in the truth, by setting and plan, and what learning was like."""

    values: Mapping[str, Mapping[str, float]]
    gate: bool
    converged: bool


def run_truth(settings: PlanReplicates, index: int, *, stop: Event | None = None) -> PlansInTruth:
    """Draw a truth and its study, learn, plan, and value the plans in the truth. Depends on its arguments only."""

    def may_go_on(number: int = 0, chain: Chain | None = None) -> None:
        if stop is not None and stop.is_set():
            raise CancelledError

    key = (STREAM, settings.states, index)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=key))
    seed = int(np.random.SeedSequence(settings.seed, spawn_key=(*key, 1)).generate_state(1)[0])
    truth = prior_draw(Layout(PUBLISHED, settings.states), settings.prior, rng)
    log = simulated_study(truth, settings.participants, "simulated_plans", rng)
    may_go_on()
    em = BaumWelch(settings.states, restarts=settings.restarts, rounds=1, seed=seed).fit(log)
    may_go_on()
    own = settings.sampler
    sampler = NutsSettings(own.draws, own.tune, own.chains, seed, own.target_accept)
    posterior = fit(log, settings.states, prior=settings.prior, sampler=sampler, finished=may_go_on)
    may_go_on()
    believed = Schedule.of(posterior.draws(), settings.schedule)
    costs: dict[str, dict[str, float]] = {SETTINGS[0]: {}}
    costs[SETTINGS[1]] = {
        a: c for flip in contested(believed)[1] if flip.multiple is not None for a, c in flip.costs.items()
    }
    values = {}
    for name, changed in costs.items():
        may_go_on()
        values[name] = _valued(
            with_costs(believed, changed),
            with_costs(Schedule.of(of_truth(truth, log), settings.schedule), changed),
            em.draws(), settings.alpha,
        )  # fmt: skip
    return PlansInTruth(values, posterior.gate.passed, em.converged)


def _valued(believed: Schedule, truth: Schedule, estimate: ModelDraws, alpha: float) -> dict[str, float]:
    """What each plan is worth in the truth."""
    own = own_plans(believed)
    regret = cautious_plan(believed, alpha, reference=own.values)
    careful = cautious_plan(believed, alpha)
    worst = cautious_plan(believed, 0.0)

    def by_model(draws: ModelDraws) -> Decisions:
        return solve_schedule(with_costs(_rebased(truth, draws), dict(truth.draws.reward.costs))).decisions  # type: ignore[union-attr]

    plans: dict[str, list[tuple[float, Decisions]]] = {
        BAYES: [(1.0, solve_schedule(believed).decisions)],
        PLUG_IN: [(1.0, by_model(estimate))],
        "posterior mean": [(1.0, by_model(ModelDraws.from_models([posterior_mean(believed.draws)])))],
        CAUTIOUS: list(zip(careful.share.tolist(), careful.plans, strict=True)),
        "worst draw": list(zip(worst.share.tolist(), worst.plans, strict=True)),
        "small regret": list(zip(regret.share.tolist(), regret.plans, strict=True)),
    }
    evaluator = PlanEvaluator(truth)
    out = {name: float(sum(s * evaluator.values(p)[0] for s, p in mix)) for name, mix in plans.items()}
    simple: tuple[Policy, ...] = (never(truth.protocol), always(truth.protocol))
    out |= {p.name: evaluate_schedule(p, truth).value for p in simple}
    out["optimum"] = solve_schedule(truth).value
    return out


def _rebased(schedule: Schedule, draws: ModelDraws) -> Schedule:
    """The same events under other models."""
    return Schedule(draws, schedule.modes, schedule.discount, schedule.terminal)


@dataclass(frozen=True)
class PlanReport(NotebookView):
    """What came of all truths.

    Attributes
    ----------
    settings : PlanReplicates
    results : tuple of PlansInTruth
    """

    _whose = "simulated"

    settings: PlanReplicates
    results: tuple[PlansInTruth, ...]

    def values(self, setting: str, plan: str) -> Array:
        """Worth in every truth."""
        return np.array([r.values[setting][plan] for r in self.results])

    def rows(self) -> list[dict[str, Any]]:
        """One row a setting and plan: mean, tail, regret, and the paired difference to the plug-in plan."""
        n, out = len(self.results), []
        same = np.full(n, 1.0 / n)
        for setting in SETTINGS:
            optimum, base = self.values(setting, "optimum"), self.values(setting, PLUG_IN)
            for plan in self.results[0].values[setting]:
                v = self.values(setting, plan)
                gain = v - base
                se = float(gain.std(ddof=1) / np.sqrt(n))
                out.append(
                    {
                        "setting": setting, "plan": plan, "mean": float(v.mean()),
                        "tail": cvar(v, same, self.settings.alpha), "mean_regret": float((optimum - v).mean()),
                        "tail_regret": -cvar(v - optimum, same, self.settings.alpha), "gain": float(gain.mean()),
                        "gain_se": se, "gain_low": float(gain.mean() - 1.96 * se),
                        "gain_high": float(gain.mean() + 1.96 * se),
                        "better": float(np.mean(gain > 1e-9)), "worse": float(np.mean(gain < -1e-9)),
                    }
                )  # fmt: skip
        return out

    def tail_difference(
        self, setting: str, plan: str, other: str, *, regret: bool = False
    ) -> tuple[float, float, float]:
        """Difference of two plans in the lower tail over truths, with its 95% bootstrap interval.

        Parameters
        ----------
        setting, plan, other : str
        regret : bool
            Of minus the regret instead of the value.
        """
        n = len(self.results)
        zero = self.values(setting, "optimum") if regret else np.zeros(n)
        a, b = self.values(setting, plan) - zero, self.values(setting, other) - zero
        # By rank the draws of a sample of equal weights always count the same in the tail.
        share = RiskSet(np.full(n, 1.0 / n), self.settings.alpha).lowest(np.arange(float(n)))[1]
        rng = np.random.default_rng(np.random.SeedSequence(self.settings.seed, spawn_key=(STREAM, 0, 0, 2)))
        again = rng.integers(n, size=(BOOTSTRAP, n))
        low, high = np.quantile((np.sort(a[again]) - np.sort(b[again])) @ share, [0.025, 0.975])
        return float((np.sort(a) - np.sort(b)) @ share), float(low), float(high)

    @property
    def sentence(self) -> str:
        """What the claims came to."""
        parts = []
        for setting in SETTINGS:
            row = next(r for r in self.rows() if r["setting"] == setting and r["plan"] == BAYES)
            value = self.tail_difference(setting, CAUTIOUS, BAYES)
            regret = self.tail_difference(setting, "small regret", BAYES, regret=True)
            parts.append(
                f"at {setting} the Bayes-adaptive plan is worth {row['gain']:+.2f} reward units a person against "
                f"the plug-in plan (95% {row['gain_low']:+.2f} to {row['gain_high']:+.2f}; better in "
                f"{row['better']:.0%}, worse in {row['worse']:.0%} of the truths); in the worst "
                f"{self.settings.alpha:.0%} of the truths the cautious plan is worth {_span(value)} against it, "
                f"and the plan of small regret has {_span(regret)} less regret"
            )
        failed = sum(not r.gate for r in self.results)
        text = f"Over {len(self.results)} simulated truths of {self.settings.states} states, " + "; ".join(parts)
        return text + (
            f". {failed} of the posteriors failed their gate and are counted all the same." if failed else "."
        )

    def to_dict(self) -> dict[str, Any]:
        """The result as a file holds it."""
        s = self.settings
        differences = {
            setting: {
                f"{plan} - {BAYES}{', regret' if regret else ''}": self.tail_difference(
                    setting, plan, BAYES, regret=regret
                )
                for plan in (CAUTIOUS, "worst draw", "small regret", PLUG_IN)
                for regret in (False, True)
            }
            for setting in SETTINGS
        }
        return {
            "settings": {
                "states": s.states, "replicates": s.replicates, "participants": s.participants,
                "schedule": s.schedule, "alpha": s.alpha, "stay": s.prior.stay, "draws": s.sampler.draws,
                "tune": s.sampler.tune, "chains": s.sampler.chains, "restarts": s.restarts,
            },
            "table": self.rows(), "tail_differences": differences,
            "failed_gates": sum(not r.gate for r in self.results),
            "unconverged_em": sum(not r.converged for r in self.results),
            "values": {
                setting: {p: self.values(setting, p).tolist() for p in self.results[0].values[setting]}
                for setting in SETTINGS
            },
            "sentence": self.sentence,
        }  # fmt: skip


def _span(found: tuple[float, float, float]) -> str:
    return f"{found[0]:+.2f} ({found[1]:+.2f} to {found[2]:+.2f})"


def replicate_plans(
    settings: PlanReplicates, *, executor: Executor | None = None, progress: Progress | None = None
) -> PlanReport:
    """Run the simulation.

    Parameters
    ----------
    settings : PlanReplicates
    executor : concurrent.futures.Executor, optional
        Threads of this process by default. No result depends on it.
    progress : callable, optional
    """
    results = run_replicates(
        run_truth, settings, settings.replicates, label="truths", executor=executor, progress=progress
    )
    return PlanReport(settings, results)
