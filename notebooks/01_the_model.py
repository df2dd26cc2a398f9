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
# # The model: what a robot can know about a person's willingness to help
#
# **The question.** A robot and a person work side by side. Now and then one of them is stuck, and the other may help at
# some cost. Does it pay for the robot to help, or to signal that it needs help, because this makes the person more
# willing to help later? Zahedi et al. (2026) answer with a latent-state POMDP: the person's *prosociality* is a hidden
# state that moves with what the robot does, and shows only in whether the person helps.
#
# This notebook builds that model from its parts and does each step once by hand. The nine after it learn its tables,
# ask how sure they are, plan with them, and take all of it to a file of your own.
#
# **The data.** None about people. All tables come from `data/simulated/calibrated_truth.json`: a *made-up truth*, tuned
# so that studies drawn from it resemble the published statistics. It is not the authors' estimate, and nothing below is
# evidence about anybody.
#
# **The model.** A person has a hidden state $s \in \{s_0, \ldots, s_3\}$. In round $k$ the robot does $a_k$, the person
# responds with $o_k$, and the state moves:
#
# $$s_0 \sim b_0, \qquad o_k \sim O(\cdot \mid s_k, a_k), \qquad s_{k+1} \sim T(\cdot \mid s_k, a_k), \qquad
# R(s, a) = e^{r x_s} - e^{r x_0} - C_a.$$
#
# All ten notebooks call the workbench `wb`: each name is loaded from where it lives when it is first asked for, and
# `wb.Protocol?` says what it does and where that is.

# %% tags=["parameters"]
FAST = False
SEED = 1

# %%
import tempfile
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

import analysis.workbench as wb

# %% [markdown]
# ## The protocol, and a trap in its letters
#
# In every round exactly one of the two needs help; this is the *mode* $M_k$, and both know it. The mode decides what
# the robot may do and whether we see anything of the person:

# %%
pd.DataFrame(
    {
        "letter": mode.letter,
        "who needs help": mode.name,
        "the robot's choices (cost)": ", ".join(f"{a.name} ({a.cost:g})" for a in mode.actions),
        "does the person's response show?": mode.shows_response,
    }
    for mode in wb.PUBLISHED.modes
)

# %% [markdown]
# The trap: the letters of a schedule such as `HRHRH` name who has the **opportunity to help**, not who is in need.
# `H` means that the *human may help*, so it is the *robot* that is stuck. Read the wrong way round, every response is
# filed under a round in which none could be seen. There is one converter for this in the whole workbench:

# %%
[mode.name for mode in wb.PUBLISHED.modes_from_letters("HRHRH")]

# %% [markdown]
# ## One round, in order
#
# 1. The mode $M_k$ is known.
# 2. The robot acts: $a_k$.
# 3. The person responds **from the state they are in now**, $o_k \sim O(\cdot \mid s_k, a_k)$, if the robot is in need;
#    otherwise nothing is seen.
# 4. Only then the state moves, $s_{k+1} \sim T(\cdot \mid s_k, a_k)$.
#
# A textbook POMDP swaps the last two: the state moves first, and the observation comes from the state *after*,
# $O(o \mid s', a)$. Here the two belong together in one kernel,
#
# $$P(s', o \mid s, a) = O(o \mid s, a)\, T(s' \mid s, a).$$
#
# So a belief $b$ (one probability a state) becomes
#
# $$b'(s') = \frac{\sum_s b(s)\, O(o \mid s, a)\, T(s' \mid s, a)}{\sum_s b(s)\, O(o \mid s, a)}.$$

# %% [markdown]
# ## A made-up truth
#
# Four states, from non-prosocial to high-prosocial. First where people start, and how likely they are to help when the
# robot is stuck, without and with a signal.

# %%
truth = wb.calibrated_truth()
help_column = wb.PUBLISHED.response_names.index("help")
frame = pd.DataFrame({"initial belief": truth.initial}, index=truth.state_names)
for row, action in enumerate(wb.PUBLISHED.emission_actions):
    frame[f"helps after {action}"] = truth.emission[row, :, help_column]
frame

# %%
helping = {a: truth.emission[row, :, help_column] for row, a in enumerate(wb.PUBLISHED.emission_actions)}
wb.show(
    wb.observation_curves(helping, {}, truth.state_names, measure="probability to help", limits=(0, 1)),
    "truth",
    "Probability that a person helps the stuck robot, by latent state. No estimate, hence no intervals.",
)

# %% [markdown]
# **How to read it.** The states differ mostly between `s0` and `s2`. From `s2` on nearly everybody helps, so responses
# hardly tell `s2` from `s3`: remember this when [notebook 03](03_baum_welch_and_its_traps.ipynb) tries to learn four
# states. **What not to conclude:** that there are four kinds of people. Four is how fine this made-up picture is.
#
# Next, how each action moves the state. Circles are states, arrows are moves in one round; thick is likely, solid goes
# up, dashed goes down.

# %%
known = wb.RowEvidence(silent=False, pinned=False, visits=np.full(4, np.inf), weak=0)
for pair in (("no_help", "help"), ("no_signal", "signal")):
    left, right = wb.panels(4.6, 4.6, height=3.0)
    for ax, action in zip((left, right), pair, strict=True):
        wb.state_graph(truth.transition[wb.PUBLISHED.action(action)], truth.state_names, action, known, ax=ax)
    words = " and after ".join(action.replace("_", " ") for action in pair)
    wb.show(left, "truth", f"Moves of the state in one round, after {words}.")

# %% [markdown]
# **How to read it.** Withholding help pulls people down, helping pushes them up, a signal nudges them up a little.
# **What not to conclude:** that people are like this. These numbers were chosen.

# %% [markdown]
# ## Believing, step by step
#
# A person starts at $b_0$. The robot is stuck and signals; the person helps. Three lines of arithmetic give the belief
# afterwards:

# %%
signal = wb.PUBLISHED.action("signal")
likelihood = truth.emission[wb.PUBLISHED.emission_index[signal], :, help_column]
joint = truth.initial * likelihood  # the state now, and the response
by_hand = joint @ truth.transition[signal] / joint.sum()  # divide by P(help), then let the state move
by_method = truth.update(truth.initial, "signal", "help")
print("by hand   ", by_hand.round(4))
print("by update ", by_method.round(4))
print("the response had probability", truth.response_probability(truth.initial, "signal")[help_column].round(4))
assert np.allclose(by_hand, by_method)

# %% [markdown]
# The textbook's order gives another answer from the same tables, because it looks at the response only after the move:

# %%
moved = truth.initial @ truth.transition[signal]
textbook = moved * likelihood / (moved @ likelihood)
pd.DataFrame({"this model": by_method, "textbook order": textbook}, index=truth.state_names).round(4)

# %% [markdown]
# The gap is small after a help and large after a refusal, where the response says much about the state *before* the
# move:

# %%
refused = moved * (1 - likelihood)
pd.DataFrame(
    {"this model": truth.update(truth.initial, "signal", "no_help"), "textbook order": refused / refused.sum()},
    index=truth.state_names,
).round(4)

# %% [markdown]
# A whole encounter `HRHRH`. In `R` rounds nothing is seen, so the belief only moves; that is what leaving out the
# response means in `update`.

# %%
events = [("no_signal", "no_help"), ("help", None), ("signal", "help"), ("help", None), ("no_signal", "help")]
beliefs, labels = [truth.initial], ["at the\nstart"]
for action, response in events:
    beliefs.append(truth.update(beliefs[-1], action, response))
    labels.append(f"{action},\n{response or 'nothing seen'}".replace("_", " "))
wb.show(
    wb.belief_path(np.array(beliefs), labels, truth.state_names),
    "truth",
    "The robot's belief about one imagined person: at the start, and after each of five rounds.",
)

# %% [markdown]
# **How to read it.** One bar a belief; darker is more prosocial. The refusal in the first round moves the belief far
# down; being helped (second and fourth round) moves it up although nothing was observed, because the tables say so.
# **What not to conclude:** that the rise in silent rounds is evidence. It is prediction.
#
# [Notebook 06](06_plans_and_baselines.ipynb) has this step to play with: press what the robot does and how the person
# responds, and watch the belief move.

# %% [markdown]
# ## What a round is worth
#
# $$R(s, a) = -C_a + e^{r x_s} - e^{r x_0}$$
#
# in *reward units*: one act of helping costs $C = 15$. The scores $x$ (tokens a round the team collects, by state) and
# the steepness $r = 0.06$ are the published ones.

# %%
pd.DataFrame(truth.reward_table(), index=wb.PUBLISHED.action_names, columns=truth.state_names).round(1)

# %%
wb.show(
    wb.reward_by_state(truth.reward.x, (0.04, 0.06, 0.08), truth.state_names, cost=15.0),
    "definition",
    "What a round in each state is worth before the robot's cost, for three values of $r$.",
)

# %% [markdown]
# **How to read it.** Nearly all of the reward sits in the top state, the more so the larger $r$. A robot that helps at
# a cost of 15 is betting on moving people *there*. **What not to conclude:** that the gain is that large. $r$ is a
# choice ([notebook 09](09_sensitivity_and_safeguards.ipynb) varies it), and rewards of models with another number of
# states are in another currency.

# %% [markdown]
# ## Drawing people
#
# `simulate_responses` keeps a design (who was in which mode when, and what the robot did) and draws states and
# responses. Here is the design of one participant of the bundled study, lived through by three simulated people, with
# the state that nobody would see:

# %%
bundled = wb.load("simulated_study1").log
design = bundled.select(runs=(bundled.schedules() == "HHRRH") & (bundled.condition == 2))
design = design.select(participants=design.participant[:1])
rng = np.random.default_rng(SEED)
person = design.to_frame()[["k", "mode", "action"]]
for i in range(3):
    drawn, states = wb.simulate_responses(truth, design, rng)
    seen = drawn.to_frame()["observation"].astype(str)
    person[f"person {i + 1}"] = [f"{o} (in s{s})" for o, s in zip(seen, states, strict=True)]
person

# %% [markdown]
# Many people drawn this way must help as often as the tables say they will. The exact probability comes from carrying
# the belief forward without looking at responses; the share is counted among people in `help+signal` with the schedule
# `HHRRH`.

# %%
many = wb.simulate_study1(participants=5_400 if FAST else 540_000, seed=SEED)
chosen = many.select(conditions=["help+signal"])
chosen = chosen.select(runs=chosen.schedules() == "HHRRH")
belief, exact, counted = truth.initial, {}, {}
for k, mode in enumerate(wb.PUBLISHED.modes_from_letters("HHRRH")):
    action = "signal" if mode.shows_response else "help"
    if mode.shows_response:
        exact[k] = truth.response_probability(belief, action)[help_column]
        counted[k] = float((chosen.response[chosen.k == k] == help_column).mean())
    belief = truth.update(belief, action)

# %%
wb.show(
    wb.curves(
        {"exact": (list(exact), list(exact.values())), "counted": (list(counted), list(counted.values()))},
        xlabel="round k (only rounds in which the robot is stuck)",
        ylabel="help rate",
    ),
    "simulated",
    f"Help rate of {chosen.n_participants:,} simulated people against the probability computed from the tables.",
)

# %% [markdown]
# **How to read it.** The two lines should lie on each other, and do, within sampling error (some 0.002 for as many
# people; mind the scale). Between the first two responses the robot only signalled, and little changes; between the
# second and the third it also helped twice. **What not to conclude:** that helping works. The truth was made that way.

# %% [markdown]
# ## Another protocol, from a few lines of text
#
# Nothing in the workbench assumes two modes, four actions or two responses. Three modes and three responses (refusing,
# helping late, helping at once) are one TOML text away; every table takes its shape from the protocol.

# %%
CORRIDOR = """
name = "corridor"
[modes]
robot_is_stuck = { letter = "S", actions = { wait = 0, ask = 5, offer_trade = 8 }, null_action = "wait", shows_response = true }
human_is_stuck = { letter = "P", actions = { pass_by = 0, assist = 15 }, null_action = "pass_by", shows_response = false }
narrow_door = { letter = "D", actions = { go_first = 0, give_way = 2 }, null_action = "go_first", shows_response = true }
[responses]
refused = 0.0
helped_late = 0.5
helped = 1.0
"""
corridor = wb.Protocol.from_dict(tomllib.loads(CORRIDOR), "corridor.toml")
print([mode.name for mode in corridor.modes_from_letters("SPD")])
print("actions:", corridor.action_names, "- of which a response can show after:", corridor.emission_actions)

# %%
grumpy_or_kind = np.array([[0.6, 0.3, 0.1], [0.1, 0.3, 0.6]])
sticky = np.array([[0.8, 0.2], [0.1, 0.9]])
small = wb.LatentStatePOMDP(
    initial=np.array([0.5, 0.5]),
    transition=np.stack([sticky] * corridor.n_actions),
    emission=np.stack([grumpy_or_kind] * len(corridor.emission_actions)),
    protocol=corridor,
)
belief = small.initial
for action, response in [("ask", "helped_late"), ("assist", None), ("give_way", "helped")]:
    belief = small.update(belief, action, response)
    print(f"after {action}, {response or 'nothing seen'}: {belief.round(3)}")

# %% [markdown]
# ## Models as files
#
# A model is a JSON file that carries its protocol; what is read back is what was written. Mistakes are answered with
# the place, what was found and what was wanted:

# %%
with tempfile.TemporaryDirectory() as folder:
    wb.write_model(small, Path(folder) / "model.json")
    again = wb.read_model(Path(folder) / "model.json")
print("read back unchanged:", np.array_equal(again.transition, small.transition), again.protocol == corridor)

content = wb.model_to_dict(truth)
content["transition"]["help"][0][0] = 0.6
try:
    wb.model_from_dict(content, "model.json")
except wb.InputError as error:
    print(error)

# %% [markdown]
# ## What to take along
#
# | question | where the answer stands |
# |---|---|
# | who helps in an `H` round? | the human; the robot is the one in need |
# | which state does a response show? | the one the round *started* from |
# | what does a silent round tell? | nothing; the belief moves by the tables alone |
# | what is a round worth? | reward units, of which one act of help costs 15; $r$ is a choice |
#
# ## What not to conclude
#
# - That any of these numbers is about people. The tables are invented; they make the model concrete and nothing else.
# - That a state is a disposition somebody measured. "High-prosocial" is a name for "helps nearly always", given by the
#   order of the response probabilities.
# - That the state moves with the robot's action *and with nothing else*. This is an assumption: fatigue, practice and
#   the person's own past are not in it.
#
# Next: [real data, and the one file format for all of it](02_real_data_and_the_event_log.ipynb).
