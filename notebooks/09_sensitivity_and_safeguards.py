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
# # Sensitivity and safeguards
#
# **The question.** On which numbers does the robot's plan hang, and what does it take, and cost, to let it near people?
#
# **The data.** The *simulated truth* of [notebook 01](01_the_model.ipynb), and the posterior of
# [notebook 04](04_how_sure_are_we.ipynb), learned from the *simulated* study of 540 people.
#
# **The model.** In state $s$ the action $a$ brings $R(s, a) = e^{r x_s} - e^{r x_0} - C_a$ and moves people by $T(s' \mid
# s, a)$. The numbers $r$, $x_s$, $C_a$ and the discount $\gamma$ are not learned from anybody: somebody has to choose
# them. A plan $\pi$ is worth $V(\pi)$ and spends $C(\pi)$, and it *influences*: an action moves a share of the people in
# state $s$ to another state than if they were left alone,
#
# $$TV(s, a) = \tfrac12 \sum_{s'} \bigl| T(s' \mid s, a) - T(s' \mid s, \text{null}) \bigr|.$$

# %% tags=["parameters"]
FAST = False
SEED = 1

# %%
import json
import tempfile
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import count
from pathlib import Path

import pandas as pd

import analysis.workbench as wb

# %% [markdown]
# ## What the plan depends on
#
# The paper varies $r$ and both costs and records two decisions: to help a person in need (step 0), then to signal in need of
# help (step 1). It prints neither a discount nor what the state after the second step is worth, so there are three readings
# of "the plan": without a horizon ($\gamma = 0.95$), two steps and nothing after them, two steps with the prosocial reward
# of the state they lead to. First under the truth:

# %%
truth = wb.calibrated_truth()
known = wb.ModelDraws.from_models([truth])
in_truth = wb.sensitivity_study(known, effort=wb.SensitivityEffort(variants=False))
print(in_truth.sentence)
wb.show(
    wb.whole_grid({wb.READING_WORDS[reading]: found for reading, found in in_truth.maps.items()}), "truth",
    "The paper's grid in three readings: whether the robot acts, at each step, by $r$ (across) and costs (within each block).",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Dark cells act. With two steps and nothing after them a signal is never worth its cost, whatever the
# tables say: it works on the *next* state, and there is none. That is a property of the question, not of people. The
# other two readings agree that steeper rewards and cheaper actions make the robot act, and disagree about where that
# begins. **What not to conclude:** that any of the three is the paper's figure; its tables are not printed.
#
# A grid says between which of its points a decision flips. Where exactly is found by bisection, one number moving and all
# others at the paper's values ($r$ = 0.06, both costs 15); numbers that flip nothing are left out. Without a horizon both
# ends of the bracket carry a decision that bounds prove.

# %%
rows = [
    {"moves": f.parameter, "step": f.step, "reading": f.reading, "from": f.scan[0], "to": f.scan[-1],
     "below": f.nodes.words(f.step, f.before[i]), "above": f.nodes.words(f.step, f.after[i]), "flips at": f.middle[i]}
    for f in in_truth.critical for i in range(len(f.draw))
]  # fmt: skip
pd.DataFrame(rows).sort_values(["moves", "step"], kind="stable").set_index(["moves", "step", "reading"]).round(4)

# %% [markdown]
# The cost above which help no longer pays is nearly five times as high without a horizon as with two steps and nothing after
# them. The choice between readings, which the paper leaves open, matters more than most numbers that it varies.
#
# ### As the robot would know it
#
# The robot has no truth, it has draws. Each decides for itself, at its own belief; the map shows which share of them acts.

# %%
data = wb.load("simulated_study1")
sampler = wb.NutsSettings(draws=300, tune=300, chains=2, seed=SEED) if FAST else wb.NutsSettings(seed=SEED)
posterior = wb.stored_fit(data.log, wb.log_digest(data.log), 4, sampler=sampler).posterior
print(posterior.gate.sentence)
draws = posterior.draws()
effort = wb.SensitivityEffort(
    endless_draws=10 if FAST else 60, endless_critical=3 if FAST else 20, endless_certain=2 if FAST else 8,
    few_draws=400 if FAST else 2000, few_critical=80, endless_scan=13, moved=False, variants=False,
)  # fmt: skip
learned = wb.sensitivity_study(draws, effort=effort)
print(learned.sentence)

# %%
wb.show(
    wb.whole_grid({wb.READING_WORDS["infinite"]: learned.maps["infinite"]}), "simulated",
    "The first of the three as shares of draws. Crossed: fewer than three quarters agree, so the recommendation is a toss.",
)  # fmt: skip
here = pd.DataFrame(learned.rows()).query("r == 0.06 and cost_help == 15 and cost_signal == 15")
here.set_index(["reading", "k"])[["action", "share", "verdict", "draws"]].round(2)

# %% [markdown]
# **How to read it.** White and dark cells are knowledge, as far as the model goes. Crossed cells are a toss: another
# study of the same people might have said the opposite. Helping is one exactly where the paper plans, at $r$ = 0.06 and a
# cost of 15; and most draws would not signal even for free, because in them a signal does people no good. **What not to
# conclude:** that such draws are right about signals: the data hardly speak of them.
#
# Critical values are not numbers then but distributions, and some draws never flip:

# %%
helping, signalling = ([learned.flips(reading, "r")[step] for reading in learned.maps] for step in (0, 1))
wb.show(
    wb.critical_values(helping, ax=wb.panels(4.6, height=3.8)[0]), "simulated",
    "At which $r$ helping begins, both costs at 15, in 20 draws without a horizon and 80 in the other readings. Legend: share of "
    "the draws in which it never does.",
)  # fmt: skip
for flips in signalling:
    print(f"{flips.reading}: {flips.sentence}")

# %% [markdown]
# **How to read it.** Where a curve is steep, doubt about the tables moves the border little; where it ends below 100%, some
# draws never help at any $r$ looked at. **What not to conclude:** that the middle of a curve is *the* critical value.
#
# ### Move it yourself
#
# The truth in all three readings and 200 draws in one of them, worked out beforehand on a finer grid:

# %%
steep = (0.001, 0.02, 0.03, *(k / 1000 for k in range(35, 101, 5)))
grid = wb.RewardGrid.of(known) if FAST else wb.RewardGrid.of(known, steep, [2.5 * k for k in range(13)])
layers = {
    f"{who}: {wb.READING_WORDS[reading]}": wb.decide_grid(wb.decider_of(reading, own), grid, in_truth.discounts[reading])
    for who, own in (("truth", known), ("posterior", draws.thin(200)))
    for reading in wb.READING_WORDS if own.n_draws == 1 or reading == "two-step-terminal"
}  # fmt: skip
wb.show_slider(
    layers, "simulated",
    "What is done, by $r$ and costs; in the truth, or by how many draws. Click into a map to set both costs. In print, the "
    "two grids above stand for it.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Raise $r$ in the truth: the border of helping runs to the right, and that of signalling follows later,
# upwards. Then choose the posterior: where there was a border there is a broad band of doubt. **What not to conclude:** that
# the band would narrow on a finer grid. It is doubt about people, not about arithmetic.
#
# ### The paper's three findings
#
# *Dominant*, *more likely*, *sensitive* are words; each was given a measure before it was looked at
# (`analysis.sensitivity_findings`). As found:

# %%
for a in in_truth.findings[:3]:
    print(f"{a.key}: {a.printed}")
rows = [
    {"finding": a.key, "reading": a.reading, "in the truth": a.verdict, "over the draws": b.holds_in}
    for a, b in zip(in_truth.findings, learned.findings, strict=True)
]  # fmt: skip
pd.DataFrame(rows).sort_values("finding", kind="stable").set_index(["finding", "reading"]).round(2)

# %% [markdown]
# No reading bears out all three. In the truth help is dominant *only* from 0.08 on where nothing follows the two steps, and
# exactly there nothing is ever signalled. Among the draws, too, no finding holds in most of them in every reading, and the
# third in next to none. So whoever repeats the analysis has to say which plan is meant. The paper's own tables
# are not printed, and may differ from these.
#
# ## What limits cost
#
# A limit can be meant in two ways. A *hard budget* holds for every person: what is left of it is known, so it joins the mode
# and the plan for both is exact. A limit on the *expected* cost holds on average, and the best plan under it draws lots
# between two plans:
#
# $$\max_\pi V(\pi) \;\text{ with }\; \max_{\text{paths}} \sum_k C_{a_k} \le B, \qquad
# \max_\pi V(\pi) \;\text{ with }\; E \sum_k C_{a_k} \le L.$$
#
# The truth with signals at 5, so that there is something to choose between:

# %%
cheap = replace(truth, reward=replace(truth.reward, costs={"help": 15.0, "signal": 5.0}))
limited = wb.safeguard_study(wb.Schedule.of(cheap, wb.STUDY2), wb.Wanted(budget=30, expected_cost=30))
for told in limited.sentences[1:5]:
    print(told)
unguarded = limited.report.table.query("safeguards == 'none'").set_index("policy")
unguarded[["value", "cost", "most_cost", "help_rate", "influence"]].round(2)

# %% [markdown]
# The plan that knows of its budget keeps it for two acts of help. The plan that does not, and is stopped by a safeguard when
# too little is left, has spent on signals what the second would have cost: a safeguard keeps a limit, and only a plan makes
# the best of it. A limit on the *expected* cost buys a little more, and some people cost half as much again.

# %%
wb.show(
    wb.value_and_cost(limited.frontier, limited.budgets, limited.report, limited.drawn), "truth",
    "Value and cost over nine rounds. The line bends one way only, the squares do not.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Any two plans on the line can be mixed, and what is mixed lies on the line between them: the curve
# is concave, from the plan that spends nothing to the best plan there is. Budgets cannot be mixed so. With 10 units
# nobody can be helped two thirds of the way, and with 15 somebody can:

# %%
limited.budgets.table.query("budget <= 45").set_index("budget").round(3)

# %% [markdown]
# So `gain_per_unit` goes up as well as down, and a budget that stops just short of an act of help is mostly wasted. The
# price of certainty is the distance from a square up to the line. **What not to conclude:** that a plan on the line keeps to
# its limit with everybody: it does so on average.
#
# ## Least influence, and only when sure
#
# Two safeguards ask what an action is worth, $Q_d(a)$, in every draw $d$, going on with the plan that is being followed.
# *Minimum influence* takes, among the actions whose mean worth is within $\epsilon$ of the best, the one that moves people
# least. *Confidence* acts only if $P(Q_a > Q_\text{null})$ exceeds a threshold. Around policies, in the posterior:

# %%
rounds = wb.Schedule.of(draws.thin(100 if FAST else 400), wb.STUDY2)
study = wb.safeguard_study(rounds)
print(
    f"budget {study.wanted.budget:g}, tolerance {study.wanted.tolerance:g}, confidence {study.wanted.confidence:g}"
)
columns = ["changed", "value", "lost", "cost", "most_cost", "influence"]
study.report.table.set_index(["policy", "safeguards"])[columns].loc[list(study.drawn)].round(2)

# %% [markdown]
# `lost` below zero: the safeguard *improved* a policy that acts too much for its own good. From the best plan it takes
# something, and how much is known. With these settings nothing at all is left of any policy: that an act pays is in no
# history nine times as probable as that it does not. The settings in between:

# %%
for told in study.sentences[-2:]:
    print(told)
drawn = wb.stricter([study.tolerance, study.threshold])
drawn.figure.set_size_inches(7.2, 4.8)
wb.show(
    drawn, "simulated",
    "The Bayes-adaptive plan under safeguards made stricter. Exact steps: between two of them no decision changes.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** To the right safeguards are stricter: value is lost in few steps, and people are moved less in the same
# ones. **What not to conclude:** that a step is the place to stop at. It says what is exchanged for what. And who is it that
# is moved?

# %%
drawn = wb.who_is_influenced(study.report, (study.best, "reactive"), (wb.NONE, "influence"))
drawn.figure.set_size_inches(9.4, 3.4)
wb.show(
    drawn, "simulated",
    "How many times a person is moved, by the state they start in and their first response; bars span nine tenths of the draws.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Influence is not spread evenly. The plan moves those most who refuse first, because it is on them
# that help seems to pay; the reactive rule moves those who help, since it answers in kind. **What not to conclude:** that
# either is wrong. It may be what is wanted, but somebody should have looked.
#
# ## The robot's side
#
# A robot gets a file: the paper's policy for the mean tables, three safeguards with mild settings, and the declared
# fallback. Reading and running it needs numpy and nothing else. The clock is made up, so that this page comes out the
# same every time.

# %%
folder, ticks = tempfile.TemporaryDirectory(), count()
file, log = Path(folder.name) / "robot.json", Path(folder.name) / "person-1.log"
paper, protocol = wb.ls_pomdp(mean_of=rounds), truth.protocol
guards = [wb.MinimumInfluence.of(rounds.draws, 1), wb.Confidence.of(protocol, 0.7), wb.CostBudget.of(protocol, 15)]
wb.write_policy(wb.Guarded(paper, guards, wb.fallback_of(protocol), wb.ScheduleWorth(paper, rounds)), file)


# %%
def clock():
    return datetime(2026, 1, 5, 9, tzinfo=UTC) + timedelta(seconds=10 * next(ticks))


session = wb.Session(wb.read_policy(file), log, seed=SEED, clock=clock)
needs = {"H": "robot_needs_help", "R": "human_needs_help"}  # the letter says who helps
for k, letter in enumerate(wb.STUDY2[:4]):
    decision = session.act(needs[letter])
    print(f"{k} {needs[letter]}: {decision.explanation}")
    if k < 3:
        session.observe("no_help" if letter == "H" else None)

# %% [markdown]
# Then the machine fails, while it writes. Nobody has seen the outcome of the last decision:

# %%
pending = session.pending
del session
with log.open("ab") as cut:
    cut.write(b'{"n":9,"event":"obse')
session = wb.Session.restore(log, clock=clock)
print("the same decision is pending:", session.pending == pending)
session.observe()
print(session.act("robot_needs_help").explanation)
session.observe("help")

# %% [markdown]
# And the person has had enough. What was believed is deleted, the fallback looks at the mode and nothing else, and the
# log no longer takes down what the person does:

# %%
session.withdraw()
print(session.act("human_needs_help").explanation)
session.observe()
print(session.act("robot_needs_help").action, "| memory:", session.memory)
session.observe("no_help")
session.close()
kept = session.last_hash
for line in log.read_text().splitlines()[-5:]:
    print(
        {key: v for key, v in json.loads(line).items() if key in ("n", "event", "k", "action", "response", "time")}
    )

# %% [markdown]
# ### Can the log be trusted?
#
# Every line is sealed with $h_n = \text{SHA-256}(h_{n-1} \,\|\, \text{line})$, and since the first line holds the policy,
# every decision can be made again (`prosocial audit verify` does the same):

# %%
print(wb.verify(log, kept).sentence)
lines = log.read_bytes().splitlines(keepends=True)
at = next(n for n, line in enumerate(lines) if b'"response":"no_help"' in line)
forged = [*lines[:at], lines[at].replace(b"no_help", b"help"), *lines[at + 1 :]]
for finding in wb.verify(b"".join(forged)).findings[:2]:
    print(finding)


# %% [markdown]
# A forger who knows the format seals everything anew. The chain holds then, but the robot's decisions no longer follow from
# what it is said to have seen:


# %%
def sealed_anew(lines, previous=wb.ROOT):
    for line in lines:
        body = line[: line.rindex(b',"hash":')]
        previous = wb.seal(previous, body)
        yield body + f',"hash":"{previous}"}}\n'.encode()


audit = wb.verify(b"".join(sealed_anew(forged)))
print(f"chain: {audit.chain_ok}, replay: {audit.replay_ok}. {str(audit.findings[0])[:200]}")

# %% [markdown]
# Two forgeries remain that no chain can show: an end that was cut off, and a lie on which no decision rests, such as the
# last answer before the withdrawal. They are found by the last hash, if somebody else keeps it:

# %%
last = next(n for n, line in enumerate(lines) if b'"response":"help"' in line)
lie = [*lines[:last], lines[last].replace(b'"help"', b'"no_help"'), *lines[last + 1 :]]
for name, content in {"end cut off": lines[:-3], "last answer changed": list(sealed_anew(lie))}.items():
    alone, known_end = (wb.verify(b"".join(content), end) for end in (None, kept))
    print(f"{name}: good without the last hash: {alone.ok}; with it: {known_end.ok}, {known_end.findings[-1]}")
folder.cleanup()

# %% [markdown]
# And nothing at all shows that what the robot was *told* is what the person did, or that every person has a log.
#
# ## What to take along
#
# | question | where the answer stands |
# |---|---|
# | on which numbers does the plan hang? | critical values, in each reading of "the plan" |
# | how sure is a map? | the share of the draws, crossed where it is a toss |
# | what does a limit cost? | the line for limits on average, the squares for hard ones |
# | what did the robot do, and why? | the log, checked against a last hash that somebody else keeps |
#
# ## What not to conclude
#
# - That the critical values are facts about people: they are facts about tables that this project made up, or learned from
#   people that it simulated, and about a reward that nobody measured.
# - That a map without crosses is certain: draws agree within the model, and share its mistakes; the choice of states, prior
#   and scores is another doubt (`prosocial sensitivity` and the report go through them).
# - That the settings above are recommendations: a budget, a tolerance and a threshold are for those who answer for the robot.
# - That a small influence is a harmless one: total variation counts how many are moved, not whether they would have agreed.
# - That a robot with an honest log is an honest robot.
#
# Next: [your own study, from your own file to a decision](10_your_own_study.ipynb).
