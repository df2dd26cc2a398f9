# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Plans and baselines
#
# **The question.** If we knew how people change, what should the robot do, how much better is that than a simple rule,
# and how sure is the answer?
#
# **The data.** A *simulated truth*: tables chosen by this project so that the published design drawn from them lands
# near the published statistics. At the end, tables learned from the *simulated* study.
#
# **The model.** That of [notebook 01](01_the_model.ipynb). In round $k$ everybody knows who needs help, $M_k$. The robot
# believes $b(s)$ about the person, acts, perhaps sees a response, and
#
# $$b'(s') \propto \sum_s b(s)\, O(o \mid s, a)\, T(s' \mid s, a), \qquad
# R(s, a) = -C_a + e^{r x_s} - e^{r x_0}.$$
#
# A plan $\pi$ says what to do after every history, and is worth $V(\pi) = E \sum_k \gamma^k R(s_k, a_k)$. Values are in
# reward units; one act of helping costs 15.

# %% tags=["parameters"]
FAST = False
SEED = 1

# %%
from dataclasses import replace

import analysis.workbench as wb

# %%
truth = wb.calibrated_truth()
wb.show(
    wb.reward_by_state(wb.PUBLISHED_X, (0.001, 0.04, 0.06, 0.08, 0.09), truth.state_names, cost=15), "definition",
    "What a person in each state is worth a round, by the steepness $r$ (the paper's figure). The axis is linear up to 10 "
    "and logarithmic above.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** At $r = 0.06$, with which the paper plans, a round in the third state is worth about one act of help.
# So help has to move people further than that, or for longer than a round, to come back. **What not to conclude:** that
# $r$ was measured. It was chosen, and [notebook 09](09_sensitivity_and_safeguards.ipynb) asks what hangs on it.

# %% [markdown]
# ## The study as it is run: nine rounds, HRHRHRHRH
#
# The schedule is known, so the best plan can be found exactly: over all histories of actions and responses, without a
# grid and without a tolerance. `H` means that the *human* may help.

# %%
study = wb.policy_study(truth)
print(study.sentence)
study.table.round(3)

# %% [markdown]
# Where each rule takes people:

# %%
wb.show(
    wb.curves(wb.state_paths(study), xlabel="events so far", ylabel="expected state, 0 to 3"), "truth",
    "The expected state under each policy before each event, and after the last.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Always helping keeps people most prosocial and is the *worst* rule: nine costly actions eat what they
# bring. Never helping costs nothing and lets people slide. The myopic rule is the second of these in disguise: one round
# ahead an act of help never pays for itself. The best plan helps as long as there is time for it to come back, and lets go
# at the end. **What not to conclude:** that the best plan is good for people. It is best for the reward above.
#
# A plan says what to do after every history of responses. Here it turns out not to need them: with these tables and
# costs the same actions are best whatever people do. The first rows:

# %%
study.plan.table.head(8)

# %% [markdown]
# ## The repeated interaction, without an end
#
# With a discount below one the plan goes on for ever, and no tree is deep enough. The solver brings a lower bound (a
# policy that is worth that much) and an upper bound (no policy is worth more) together.

# %%
costs = {"help": 40.0, "signal": 3.0}
problem = wb.latent_problem(truth)
contested = wb.latent_problem(replace(truth, reward=replace(truth.reward, costs=costs)))
solutions = {"published costs": wb.solve(problem, 1e-4), "help 40, signal 3": wb.solve(contested, 1e-4)}
for name, solution in solutions.items():
    print(f"{name}: {solution.sentence}")

# %%
wb.show(
    wb.value_slices(solutions["help 40, signal 3"]), "truth",
    "Help costs 40 and a signal 3: value, and below it what the policy does, on a walk through the beliefs from certainty "
    "of one state to certainty of the next.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** At these costs the decision depends on the belief: the robot stops helping once it is nearly sure of
# the top state, and saves the signal near both ends, where it changes little. At the published costs helping always and
# signalling never is best everywhere, under this truth. **What not to conclude:** that the walk shows all beliefs. It
# keeps to the edges.
#
# ### Move about in the beliefs
#
# So here is the inside. The plan looks one step ahead on its vectors, so what an action is worth is the largest of finitely
# many planes over the beliefs, and each action is best in a union of polygons: the colours, exact. Four states make a
# tetrahedron, and the triangle is a slice of it, at the belief's own share of the fourth state. Press what the robot does
# and how the person responds, and the belief moves by Bayes' rule of [notebook 01](01_the_model.ipynb).

# %%
dear = wb.latent_problem(replace(truth, reward=replace(truth.reward, costs={"help": 60.0, "signal": 6.0})))
plans = {name: found.policy for name, found in reversed(solutions.items())}
wb.show_explorer(
    plans | {"help 60, signal 6": wb.solve(dear, 1e-4).policy}, "truth",
    "What the plan does at every belief, what each action is worth, and where each response takes the belief. Drag the ring "
    "or use arrow keys, sliders and buttons. In print, the figure above stands for it.",
    held=1,
)  # fmt: skip

# %% [markdown]
# **How to read it.** A refusal throws the belief far to the left, a help moves it up by less: most people help anyway, so
# a refusal says more. In rounds without a response the belief moves all the same, by what the tables expect. At help 40 and
# signal 3 whoever refuses is helped next; at help 60 and signal 6 whoever refuses is no longer signalled to, because help to
# bring them back has become too dear. The same belief, other costs, the opposite treatment. **What not to conclude:** that
# the robot *sees* any of this. The ring is what it believes, and a robot with other tables believes something else from
# the same responses.
#
# The plan can say why:

# %%
policy = solutions["help 40, signal 3"].policy
print(policy.why(truth.initial, 0).sentence)

# %% [markdown]
# The vectors know which vector follows each response, so the policy is also a graph. It needs no belief at run time:
# the robot is in a box, does what it says, and goes where the response points.

# %%
graph = wb.policy_graph_of(solutions["help 40, signal 3"])
print(graph.sentence)
wb.show(
    wb.policy_graph(graph), "truth",
    "The policy at help 40, signal 3, from its start. Below each action: the share of the discounted time, and the "
    "expected state of the person.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Whoever refuses is helped next; whoever keeps helping is helped every other time. Seven boxes and no
# arithmetic: this is all that a robot would have to carry. **What not to conclude:** that boxes are states of the person.
# They are what the robot remembers.
#
# The value of such a controller is a linear system, no simulation:

# %%
for name, solution in solutions.items():
    controller = wb.controller_of(solution.policy).reachable()
    value = wb.infinite_value(controller, solution.problem).value
    print(
        f"{name}: {controller.n_nodes} nodes, worth {value:.4f}; bounds {solution.lower:.4f} to {solution.upper:.4f}"
    )

# %% [markdown]
# ## How hard is it to be sure?
#
# The same solver on two problems of the literature.

# %%
known = {name: wb.solve(wb.problem(name), 1e-3, time_limit=20) for name in ("tiger", "rock_sample_4_4")}
wb.show(
    wb.gap_over_time(known), "definition",
    "The gap between the bounds over time, both axes logarithmic. Tiger: the published value is 19.3714.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Each step is a round of the solver, down to the gap that was asked for: what is left between the bounds
# is all that can still be wrong. **What not to conclude:** that a small gap makes a good plan. It is small *for these
# tables*.
#
# ## With tables learned from data
#
# The robot never knows the truth. Its tables come from 540 people; its plan is as good as they are.

# %%
log = wb.load("simulated_study1").log
fit = wb.BaumWelch(truth.n_states, restarts=30 if FAST else 200, seed=SEED).fit(log)
learned = wb.policy_study(truth, learned=fit.model)
print(learned.sentence)
learned.table.round(3)

# %% [markdown]
# How wrong are they? Areas show where each policy takes people in the truth, dashes what the robot believes meanwhile.

# %%
robots = [wb.PlanPolicy.of(learned.learned_plan, "learned plan"), wb.never(truth.protocol), wb.always(truth.protocol),
          wb.Reciprocal(truth.protocol)]  # fmt: skip
for ax, robot in zip(wb.panels(2.5, 2.5, 2.5, 2.5, height=2.4), robots, strict=True):
    states, believed = wb.belief_paths(robot, truth, fit.model)
    wb.belief_trajectory(states, wb.STUDY2, truth.state_names, believed=believed, title=robot.name, ax=ax)
wb.show(
    ax, "simulated",
    "Shares by state before each round and after the last, in the truth; dashed, how the robot's mean belief divides.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** The robot's four states are not the truth's four: 540 people of five rounds each hardly determine such
# tables ([notebook 04](04_how_sure_are_we.ipynb)), and these swap states back and forth, as trap 6 of
# [notebook 03](03_baum_welch_and_its_traps.ipynb) allows. The plan does well although its tables are wrong: what counts is
# which action is best, not by how much.
#
# ## What to take along
#
# | question | where the answer stands |
# |---|---|
# | what is the best that can be done? | the exact plan; without an end, the two bounds |
# | does it beat a rule? | the table with `never`, `always` and the reactive rule in it |
# | why does the robot do this now? | what each action is worth at this belief |
# | does it matter that tables are learned? | the column `lost`, which only a known truth has |
#
# ## What not to conclude
#
# - That help pays off little or much *for people*: the truth above is made up.
# - That a learned plan is nearly best because its *estimated* value is high: the column `lost` is known only because the
#   truth is.
# - That a certificate is about the world. It bounds what is lost by solving, nothing of what is lost by not knowing.
#
# Next: [robust planning and the value of information](07_robust_planning.ipynb): how much is lost when the truth is not
# known?
