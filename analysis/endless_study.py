"""Plans under doubt without an end: every draw solved, decisions over beliefs and histories, controllers."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING

from models.planning.alpha_policy import AlphaPolicy
from models.planning.batch import BatchSolution, solve_draws
from models.planning.belief_model import BeliefModel
from models.planning.latent import LatentBatch, latent_problem
from models.planning.solver import solve
from models.robust.candidates import posterior_mean
from models.robust.controller_pool import ControllerPool, controller_pool
from models.robust.history_stability import HistoryStability, history_stability
from models.robust.named_controllers import baseline_controllers, model_controller
from models.robust.wider_solution import WideSolution, widened

if TYPE_CHECKING:
    from models.planning.mode_process import ModeProcess

MEAN_PLAN = "the plan of the mean tables"
"""Name of what the robot does until a decision is looked at."""

Told = Callable[[str, int, int], None]


@dataclass(frozen=True)
class EndlessStudy:
    """What the draws want without an end.

    Attributes
    ----------
    solution : BatchSolution
        Every draw with its certificate.
    wide : WideSolution
        The same, solved from the corners of the simplex too, to be asked about any belief.
    along : HistoryStability
        What each draw would do next after the histories of a study.
    pool : ControllerPool
        Controllers valued in every draw.
    """

    solution: BatchSolution
    wide: WideSolution
    along: HistoryStability
    pool: ControllerPool


def endless_study(
    batch: LatentBatch, letters: str, *, executor: Executor | None = None, progress: Told | None = None
) -> EndlessStudy:
    """Solve every draw, and ask all of them about beliefs, histories and each other's plans.

    Parameters
    ----------
    batch : LatentBatch
    letters : str
        Schedule of the study whose histories are followed.
    executor : concurrent.futures.Executor, optional
        What draws are spread over; threads by default.
    progress : callable, optional
        Called with the step, pieces done and pieces in all.

    Raises
    ------
    InputError
        On a schedule that is none.
    """
    solution = solve_draws(batch, executor=executor, progress=told_of(progress, "draws solved"))
    wide = widened(solution, executor=executor, progress=told_of(progress, "draws solved from the corners"))
    along = decisions_along(wide, letters, executor=executor)
    pool = compared_controllers(solution, executor=executor, progress=told_of(progress, "controllers valued"))
    return EndlessStudy(solution, wide, along, pool)


def told_of(progress: Told | None, step: str) -> Callable[[int, int], None] | None:
    """Progress of one step."""
    return None if progress is None else lambda done, total: progress(step, done, total)


def mean_plan(batch: LatentBatch, precision: float = 1e-3) -> AlphaPolicy:
    """The plan without an end of the model with the draws' mean tables; it can follow any schedule."""
    mean = posterior_mean(batch.draws)
    process: ModeProcess = batch.process
    found = solve(latent_problem(mean, process, batch.discount), precision)
    tracker = BeliefModel.of_latent(mean, impossible="keep")
    return AlphaPolicy(
        found.problem, found.alpha, found.mode, found.choice, found.follow, MEAN_PLAN, tracker=tracker
    )  # fmt: skip


def decisions_along(solution: WideSolution, letters: str, *, executor: Executor | None = None) -> HistoryStability:
    """What each draw would do next after every history of a study in which the robot follows the mean tables' plan.

    Parameters
    ----------
    solution : WideSolution
    letters : str
    executor : concurrent.futures.Executor, optional
    """
    return history_stability(solution, letters, mean_plan(solution.batch), executor=executor)


def compared_controllers(
    solution: BatchSolution, *, executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ControllerPool:  # fmt: skip
    """Controllers of the draws beside baselines and the controller of the posterior mean.

    Parameters
    ----------
    solution : BatchSolution
    executor : concurrent.futures.Executor, optional
    progress : callable, optional
    """
    batch = solution.batch
    mean = posterior_mean(batch.draws)
    named = {"posterior mean": model_controller(batch, mean, "posterior mean"), **baseline_controllers(batch, mean)}
    return controller_pool(solution, named, executor=executor, progress=progress)
