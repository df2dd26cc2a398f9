"""Section: what the robot should do if the learned model were true, over the study's rounds and without an end."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from analysis.figures.planning import value_slices
from analysis.figures.planning_beliefs import belief_trajectory
from analysis.figures.planning_graph import MOST_NODES, policy_graph
from analysis.figures.reward import reward_by_state
from analysis.figures.style import spoken
from analysis.learned_policy import LearnedPolicy, learned_policy
from analysis.policy_study import LEARNED, OPTIMAL, SIMULATED_RUNS, belief_paths
from analysis.report.context import ReportContext
from analysis.report.doubts import doubts, reservations, told_above
from analysis.report.own_reward import (
    planned_states,
    rewarded_model,
    rounds_of,
    title_of,
    unseen_or_left_out,
    want_reward,
)
from analysis.report.section import Block, Figure, NotSupported, Origin, Part, Table, Text, attempt, with_something
from analysis.report.sections.plan_headlines import by_estimate
from analysis.response_rates import measure_name
from analysis.simulate import STUDY1_NAME, calibrated_truth
from analysis.stated_reward import letters_in_words
from analysis.wording import counted
from models.lspomdp import LatentStatePOMDP
from models.planning.baselines import baselines
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Policy
from models.reward import PUBLISHED_X

QUICK_RUNS = 2_000
"""Simulated runs of a baseline in a quick report."""

BEST, BEST_IN_TRUTH = "best plan", "best plan, were the truth known"
SHOWN = ("never", "always", "reactive")
"""Baselines whose way is drawn beside the best plan's."""


def make(context: ReportContext) -> tuple[Block, ...]:
    """One part for each number of states that is shown in full."""
    want_reward(context)
    shown = planned_states(context)
    parts = []
    for k in shown:
        blocks = attempt("plans", partial(_model, context, k))
        parts.append(Part(title_of(context, k), f"plan-{k}", blocks, folded=k != shown[0]))
    return (*_introduction(context), *with_something(parts))


def _introduction(context: ReportContext) -> tuple[Block, ...]:
    printed = context.published["reward"]
    text = (
        "This section takes the tables of the section The learned model as if they were true and asks which way of "
        "acting is worth most. How far the tables may be off is the business of the section How sure are we? "
    )
    if context.stated is not None:
        text += f"{context.stated.sentence} Values are in reward units."
    else:
        text += (
            "The reward is the paper's definition, not a finding: a round is worth the state of the person, less "
            f"{printed['cost_help']:g} for an act of help and {printed['cost_signal']:g} for a signal. Values are "
            "in reward units, and with different numbers of states in different currencies: only four states have "
            "printed scores."
        )
    blocks = [Text(text), *reservations(context)]
    truth = known_truth(context)
    if truth is not None:
        blocks.append(
            Text(
                "The truth behind these simulated people is known, so every policy is also valued in it. The robot "
                "never sees those columns; with people there are none.", "note",
            )
        )  # fmt: skip
    return tuple(blocks)


def known_truth(context: ReportContext) -> LatentStatePOMDP | None:
    """The truth that the data were drawn from, if it comes with them and has this report's reward."""
    if context.data.card.name != STUDY1_NAME:
        return None
    truth = calibrated_truth()
    if context.stated is None:
        return truth
    return context.stated.of_model(truth) if truth.n_states in context.stated.states else None


def _model(context: ReportContext, k: int) -> tuple[Block, ...]:
    if k == 1:
        raise NotSupported("with one state nothing the robot does changes anybody, so it does best to do nothing")
    fit, found = context.study.fits[k], context.study.identifications[k]
    unseen = unseen_or_left_out(context)
    runs = QUICK_RUNS if context.effort.quick else SIMULATED_RUNS
    learned = context.kept(
        f"plan of the estimate, {counted(k, 'state')}", learned_policy, rewarded_model(context, k), unseen,
        rounds_of(context), truth=known_truth(context), seed=context.seed, runs=runs,
    )  # fmt: skip
    blocks: list[Block] = [*doubts(context, k, posterior=False)]
    if unseen:
        names = " and ".join(spoken(a) for a in unseen)
        blocks.append(
            Text(
                f"Left out: {names}. These data never show what follows, so the learned tables hold placeholders "
                "there; a plan that used them would rest on nothing. What is best with that action is not known.",
                "warning",
            )
        )  # fmt: skip
    if found.pinned:
        names = " and ".join(spoken(a) for a in found.pinned)
        blocks.append(
            Text(f"The table of {names} was held fixed by choice; the values below depend on that choice.", "note")
        )
    if found.hardly_informed:
        blocks.append(
            Text(
                f"In {found.hardly_informed} of {found.n_parameters} directions these data say less about the "
                "tables than a uniform prior would (section What this does not show); the plans hang on those "
                "entries too.",
                "note",
            )
        )  # fmt: skip
    blocks += _rounds(context, learned, k)
    blocks += _endless(context, learned, k)
    blocks.append(by_estimate(context, learned, k))
    x = tuple(fit.model.reward.x)
    if x != PUBLISHED_X and context.stated is None:
        blocks.append(_reward(context, x, fit.model.state_names, k))
    return told_above(blocks, fit.model.cautions)


# -- the rounds of the study -----------------------------------------------------------------------
def _rounds(context: ReportContext, learned: LearnedPolicy, k: int) -> tuple[Block, ...]:
    study = learned.study
    letters = study.plan.schedule.letters
    text = (
        f"The study as it is run: {len(letters)} rounds {letters} ({letters_in_words(context.protocol)}), nothing "
        f"discounted, found exactly. {spoken(study.sentence)}"
    )
    return (
        Text(text), *_verdict(learned), _values(context, learned, k), _actions(context, learned, k),
        _trajectories(context, learned, k),
    )  # fmt: skip


def _verdict(learned: LearnedPolicy) -> tuple[Block, ...]:
    """What the plan is worth where the truth is known, in words."""
    if learned.in_truth is None:
        return ()
    values = {name: v.value for name, v in learned.in_truth.values.items()}
    own, best = values[LEARNED], values[OPTIMAL]
    rest = {name: v for name, v in values.items() if name not in (LEARNED, OPTIMAL)}
    winner = max(rest, key=lambda name: rest[name])
    text = (
        f"In the truth the learned model's plan is worth {own:.4g}; {best:.4g} could be had, and the best "
        f"baseline, {winner}, is worth {rest[winner]:.4g}."
    )
    if own < rest[winner] - 1e-9:
        text += " So here planning with the learned model does worse than a simple rule."
        return (Text(text, "warning"),)
    return (Text(text),)


def _values(context: ReportContext, learned: LearnedPolicy, k: int) -> Table:
    inside = {BEST if name == OPTIMAL else name: v for name, v in learned.study.values.items()}
    frame = pd.DataFrame(
        [
            {"policy": name, "value": v.value, "help": v.help_rate, "costly": v.costly_actions, "cost": v.cost}
            for name, v in inside.items()
        ]
    ).sort_values("value", ascending=False, kind="stable", ignore_index=True, key=lambda v: v.round(9))
    rate = measure_name(context.protocol)
    headings = {"value": "value", "help": rate, "costly": "costly actions", "cost": "their cost"}
    formats = {"value": ",.1f", "help": ".3f", "costly": ".2f", "cost": ",.1f"}
    caption = (
        f"Policies over {learned.study.plan.schedule.letters}, exact. {_rate_words(context, rate)} Columns under "
        "the learned model: what it promises"
    )
    groups: tuple[tuple[str, int], ...] = (("", 1), ("if the learned model is true", 4))
    origin: tuple[Origin, ...] = (context.origin,)
    if learned.in_truth is not None:
        names = {LEARNED: BEST, OPTIMAL: BEST_IN_TRUTH}
        outside = {names.get(name, name): v for name, v in learned.in_truth.values.items()}
        if BEST_IN_TRUTH not in set(frame["policy"]):
            frame.loc[len(frame)] = {"policy": BEST_IN_TRUTH}
        for column, field in (("t_value", "value"), ("t_help", "help_rate"), ("t_costly", "costly_actions")):
            frame[column] = [getattr(outside[name], field) for name in frame["policy"]]
        headings |= {"t_value": "value", "t_help": rate, "t_costly": "costly actions"}
        formats |= {"t_value": ",.1f", "t_help": ".3f", "t_costly": ".2f"}
        groups = (*groups, ("in the truth behind the simulation", 3))
        caption += "; in the truth: what would happen"
        origin = (*origin, Origin.DEFINITION)
    return Table(
        f"plan-values-{k}", frame, f"{caption}.", origin, headings=headings, formats=formats, groups=groups
    )  # fmt: skip


def _rate_words(context: ReportContext, rate: str) -> str:
    if context.is_published_protocol:
        return "Help rate: share of the rounds in which the person could help the robot and does."
    return f"{rate[0].upper()}{rate[1:]}: over the rounds that show a response."


def _actions(context: ReportContext, learned: LearnedPolicy, k: int) -> Table:
    plan = learned.study.values[OPTIMAL]
    letters = learned.study.plan.schedule.letters
    null = {m.null_action for m in learned.model.protocol.modes}
    rows = []
    for mode in learned.model.protocol.modes:
        for action in mode.actions:
            if action.name not in null:
                shares = {
                    f"{i + 1} {c}": plan.action_path[i].get(action.name, 0.0) if c == mode.letter else None
                    for i, c in enumerate(letters)
                }
                rows.append({"action": spoken(action.name), **shares})
    frame = pd.DataFrame(rows).astype({f"{i + 1} {c}": float for i, c in enumerate(letters)})
    caption = (
        "How often the best plan takes each costly action, round by round, if the learned model is true. Between "
        "0 and 1: it depends on how the person has responded so far."
    )
    formats = {column: ".2f" for column in frame.columns if column != "action"}
    return Table(f"plan-rounds-{k}", frame, caption, (context.origin,), formats=formats)


def _trajectories(context: ReportContext, learned: LearnedPolicy, k: int) -> Figure:
    world, compared = learned.model, False
    if learned.in_truth is not None:
        truth = learned.in_truth.plan.schedule.draws.model(0)
        # The robot's states are comparable with the truth's only if there are as many.
        compared = truth.n_states == world.n_states
        world = truth if compared else world
    schedule = learned.study.plan.schedule.letters
    policies: list[Policy] = [PlanPolicy.of(learned.study.plan, BEST)]
    by_name = {p.name: p for p in baselines(learned.model)}
    policies += [by_name[name] for name in SHOWN if name in by_name]
    panels, alt = [], []
    for policy in policies:
        states, believed = belief_paths(policy, world, learned.model, schedule)
        panels.append(
            partial(
                belief_trajectory, states, schedule, world.state_names, believed=believed if compared else None,
                title=policy.name,
            )
        )  # fmt: skip
        numbers = np.arange(states.shape[1])
        first, last = states[0] @ numbers, states[-1] @ numbers
        words = f"{policy.name}: expected state {first:.2f} at first, {last:.2f} at the end"
        if compared:
            words += f"; the robot believes {believed[0] @ numbers:.2f} and {believed[-1] @ numbers:.2f}"
        alt.append(f"{words}.")
    if compared:
        caption = (
            "Where policies take people in the truth behind the simulation: shares by state before each round and "
            "after the last. Dashed: what the robot believes meanwhile by its learned model, on average; where the "
            "dashes leave the edges of the areas, it is wrong about people, or its states mean something else."
        )
    else:
        caption = (
            "Where policies take people if the learned model is true: shares by state before each round and after "
            "the last. The robot's mean belief is then the same."
        )
    origin = (context.origin, Origin.DEFINITION) if compared else (context.origin,)
    return Figure(f"plan-beliefs-{k}", tuple(panels), caption, tuple(alt), origin)


# -- without an end --------------------------------------------------------------------------------
def _endless(context: ReportContext, learned: LearnedPolicy, k: int) -> tuple[Block, ...]:
    solution, graph = learned.solution, learned.graph
    problem, words = solution.problem, graph.controller.vocabulary
    text = (
        f"Without an end, modes taking turns as in the study, discount {problem.discount:g} a round: the best "
        f"value lies between {solution.lower:,.6g} (what the policy below is worth at least) and "
        f"{solution.upper:,.6g} (what no policy exceeds), a gap of {solution.gap:.2g}, "
        f"{100 * solution.relative_gap:.2g}% of the value; status: {solution.status}."
    )
    if solution.status != "converged":
        text += f" The gap asked for, {solution.precision:g} of the value, was not reached."
    if learned.policy_in_truth is not None and learned.solution_of_truth is not None:
        best = learned.solution_of_truth
        text += (
            f" In the truth that policy is worth {learned.policy_in_truth:,.5g}, of at most {best.upper:,.5g} "
            f"({best.status})."
        )
    why = [
        f"At the start ({spoken(words.modes[x])}): {spoken(solution.policy.why(belief, x).sentence)}"
        for x, _, belief in problem.starts()
        if len(words.actions[x]) > 1
    ]
    drawn = graph.busiest(MOST_NODES)
    cover = float(graph.share[drawn].sum())
    caption = (
        "The policy as a graph, from its start: each box is what the robot does, below it the share of the "
        "discounted time it spends there and the expected state of the person; each arrow is what comes next, by "
        "response. From left to right the robot takes the person for more prosocial. It needs no belief to run."
    )
    if len(drawn) < graph.controller.n_nodes:
        caption += (
            f" Drawn are {len(drawn)} of {graph.controller.n_nodes} boxes, with {cover:.0%} of the time; arrows to "
            "others end in a dot."
        )
    picture = Figure(
        f"plan-graph-{k}", (partial(policy_graph, graph),), caption, (graph.sentence,), (context.origin,)
    )
    actions = Figure(
        f"plan-map-{k}", (partial(value_slices, solution, points=40),),
        "What the policy is worth, and which action its best vector takes, by what the robot believes: a walk from "
        "certainty of each state to certainty of the next, one panel a mode.",
        (_map_words(learned),), (context.origin,),
    )  # fmt: skip
    values = _endless_values(context, learned, k)
    return (Text(text), values, *map(Text, why), actions, Text(graph.sentence), picture)


def _map_words(learned: LearnedPolicy) -> str:
    """The action map for those who do not see it: what is done where one state is certain."""
    policy, solution = learned.solution.policy, learned.solution
    parts = []
    for x, mode in enumerate(solution.problem.modes):
        states = solution.problem.states[x]
        done = [solution.choice[policy.vector(corner, x)] for corner in np.eye(len(states))]
        names = [spoken(policy.vocabulary.actions[x][int(c)]) for c in done]
        parts.append(f"{spoken(mode)}: " + ", ".join(f"{n} if s{i} is certain" for i, n in enumerate(names)))
    return "Actions over beliefs. " + "; ".join(parts) + "."


def _endless_values(context: ReportContext, learned: LearnedPolicy, k: int) -> Table:
    solution = learned.solution
    rows = [{"policy": "the policy found", "low": solution.lower, "high": solution.upper, "known": "certificate"}]
    for name, v in learned.baselines.items():
        known = "exact" if v["low"] == v["high"] else "simulated, 95% interval"
        rows.append({"policy": name, "low": v["low"], "high": v["high"], "known": known})
    frame = pd.DataFrame(rows).sort_values("low", ascending=False, kind="stable", ignore_index=True)
    caption = (
        "Values without an end if the learned model is true: for the policy found the bounds of the best value, "
        f"for baselines their value (seed {context.seed} where it is simulated)."
    )
    return Table(
        f"plan-endless-{k}", frame, caption, (context.origin,),
        headings={"low": "at least", "high": "at most", "known": "how it is known"},
        formats={"low": ",.2f", "high": ",.2f"},
    )  # fmt: skip


def _reward(context: ReportContext, x: tuple[float, ...], names: tuple[str, ...], k: int) -> Figure:
    steepness = [float(r) for r in context.published["sensitivity"]["r"]]
    used, cost = context.published["reward"]["r_policy"], float(context.published["reward"]["cost_help"])
    caption = (
        f"The reward that these plans are made for, r = {used:g}; other r for comparison. With {k} states the "
        f"scores are spread evenly over the printed range, {x[0]:g} to {x[-1]:g}: an assumption."
    )
    alt = f"Reward of {k} states with scores {', '.join(f'{v:g}' for v in x)} tokens a round, one line for each r."
    draw = partial(reward_by_state, x, steepness, names, cost=cost)
    return Figure(f"plan-reward-{k}", (draw,), caption, (alt,), (Origin.DEFINITION,))
