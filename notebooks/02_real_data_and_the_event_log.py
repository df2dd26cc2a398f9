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
# # Real data, and the one file format for all of it
#
# **The question.** What exactly goes into learning, how do we know that it is in order, and what can data of real
# people say about a model of helping a robot?
#
# **The data.** Two sets, never mixed. `simulated_study1` comes with the workbench: the published design of study 1
# filled by *simulated* people. `frd2012` are choices of 384 *real* people in a repeated prisoner's dilemma
# (Fudenberg, Rand and Dreber 2012). It is not bundled: it is fetched on first use, or taken from the folder that the
# environment variable `PROSOCIAL_DATA` names. Where it cannot be had, the cells that need it stay empty and say so.
#
# **The model.** That of [notebook 01](01_the_model.ipynb). All it takes from a person is the history
#
# $$h = \bigl((M_0, a_0, o_0), \ldots, (M_{K-1}, a_{K-1}, o_{K-1})\bigr),$$
#
# so the likelihood of $N$ people needs only the distinct histories and how often each occurs.

# %% tags=["parameters"]
FAST = False
SEED = 1

# %%
import tempfile
from contextlib import chdir
from pathlib import Path

import numpy as np
import pandas as pd
from IPython.display import Markdown, display

import analysis.workbench as wb

pd.set_option("display.max_colwidth", None)

# %%
study = wb.load("simulated_study1")
try:
    real = wb.load("frd2012")
except wb.InputError as error:
    real = None
    print(f"{wb.ABSENT}: the cells on frd2012 are skipped. {error}")

# %% [markdown]
# ## One row, one event
#
# An event is one round: who was in need (`mode`), what the robot did (`action`), how the person responded
# (`observation`). A *run* is one unbroken series of rounds of a person, numbered `k = 0, 1, 2, ...`; every run starts
# afresh from the initial belief $b_0$. `none` means that nothing could be seen, `missing` that something could have
# been but was not recorded. Text ids do not exist: people are numbers.

# %%
study.log.to_frame().head(5)

# %%
pd.Series(study.card.columns, name="what it means in the simulated study").to_frame()

# %% [markdown]
# Every data set has a card that says what it is, and what it is not:

# %%
Markdown(
    "\n".join([f"**{study.card.title}.** {study.card.what}\n"] + [f"- {item}" for item in study.card.what_not])
)

# %%
if real is not None:
    print(real.log)

# %% [markdown]
# ### How a prisoner's dilemma becomes rounds of helping
#
# In every period both players choose to cooperate or not. Period $t$ gives two events: event $2t$, in which the *other*
# is in need, the person chooses and cooperating counts as `help`; and event $2t + 1$, in which the *person* is in need
# and what the partner did is recorded as the "robot's" action. Nobody signals, so the action in the first kind of event
# is always `no_signal`.

# %%
if real is not None:
    display(real.log.to_frame().drop(columns="study").head(6))

# %% [markdown]
# ## A file that breaks a rule is refused as a whole
#
# Nothing is dropped silently. Here is a copy of the simulated study with three errors put in, and what comes back (line
# 1 is the header):

# %%
broken = study.log.to_frame().head(20).astype({"mode": str, "action": str, "observation": str})
broken.loc[2, "action"] = "signal" if broken.loc[2, "mode"] == "human_needs_help" else "help"
broken.loc[7, "k"] = 9
broken.loc[11, "observation"] = "maybe"
try:
    wb.EventLog.from_frame(broken, place="broken.csv")
except wb.EventLogError as error:
    print(error)
    problems = pd.DataFrame(error.problems)
problems

# %% [markdown]
# ## Why 54,000 people cost no more than 540
#
# People with the same history are interchangeable, so they are counted, not repeated. And histories that begin alike
# share their beginning in a *prefix tree*. Both are exact. In the published design at most
# $4 \text{ conditions} \times 6 \text{ schedules} \times 2^3 \text{ responses} = 192$ histories exist, however many
# people take part.

# %%
sizes = (540, 5_400, 54_000) if FAST else (540, 5_400, 54_000, 540_000)
rows = []
for people in sizes:
    log = study.log if people == 540 else wb.simulate_study1(participants=people, seed=SEED)
    tree = log.tree()
    rows.append({"people": people, "events": log.n_events, "histories": tree.n_histories, "nodes": tree.n_nodes})
compressed = pd.DataFrame(rows)
compressed

# %%
lines = {name: (compressed["people"], compressed[name]) for name in ("events", "nodes", "histories")}
wb.show(
    wb.curves(lines, xlabel="people", ylabel="how many", log_x=True, log_y=True),
    "simulated",
    "Events grow with the people, distinct histories and nodes of the prefix tree do not. Both axes are logarithmic.",
)

# %% [markdown]
# **How to read it.** The work of one step of learning is proportional to the nodes, so half a million people cost what a
# few thousand cost. **What not to conclude:** that this holds for any data. In the real data runs are long and of random
# length, and few are alike:

# %%
if real is not None:
    tree = real.log.tree()
    print(f"{real.log.n_runs:,} runs, {tree.n_histories:,} of them distinct")
    print(f"{real.log.n_events:,} events, {tree.n_nodes:,} nodes")

# %% [markdown]
# The most frequent histories of one condition and schedule, as (round, response) strings; the rarest are what a model
# has to explain:

# %%
one = study.log.select(conditions=["no-help+no-signal"])
one = one.select(runs=one.schedules() == "HRHRH")
words = one.to_frame().groupby("participant")["observation"].agg(" → ".join)
words.str.replace("none", "·").value_counts().rename("people").to_frame()

# %% [markdown]
# ## Who helped when: the simulated study

# %%
log = study.log
condition = np.array(log.conditions, dtype=object)[log.condition][log.run_of_event]
rates = wb.response_rates(log, {"condition": condition, "k": log.k})
axes = wb.panels(2.5, 2.5, 2.5, 2.5, height=2.7)
for ax, (name, table) in zip(axes, rates.groupby("condition"), strict=True):
    wb.rate_by_round(table, measure="help rate", limits=(0, 1), title=name, last_round=4, ax=ax)
    ax.label_outer()
wb.show(axes[0], study.card.kind, "Help rate by round and condition, with 95% intervals; at the foot, responses.")

# %%
cells = wb.response_rates(log, {"condition": condition, "schedule": log.schedules()[log.run_of_event]})
wb.show(
    wb.rate_heat_map(
        cells, rows="condition", columns="schedule", limits=(0, 1),
        row_order=list(log.conditions), column_order=sorted(set(log.schedules())),
    ),
    study.card.kind,
    "Help rate by condition and schedule over all rounds (`H`: the human may help; `R`: the robot may help).",
)  # fmt: skip

# %% [markdown]
# **How to read them.** With help (two left panels) nearly everybody goes on helping; without it the rate falls from
# round to round. One person gives three responses, which are not independent, so the intervals use the spread between
# people. **What not to conclude:** anything about people; and, even were they real, that each of the 24 cells differs
# from its neighbour: with 8 to 36 people a cell, they differ by chance too.

# %% [markdown]
# ## Who helped when: real people
#
# The same two functions, on the condition the card names (benefit/cost 4, execution error 1/8). What counts as "help"
# is cooperating.

# %%
if real is not None:
    part = real.log.select(conditions=[real.card.defaults["condition"]])
    left, right = wb.panels(4.6, 5.4, height=3.1)
    wb.rate_by_round(wb.response_rates(part, {"k": part.k}), measure="help rate", limits=(0, 1), ax=left)
    wb.plot_still_going(wb.still_going(part), ax=right)
    wb.show(
        left,
        real.card.kind,
        "Left: cooperation by round, with 95% intervals. Right: the share of runs that have that round.",
    )

# %%
if real is not None:
    real_condition = np.array(real.log.conditions, dtype=object)[real.log.condition][real.log.run_of_event]
    display(wb.response_rates(real.log, {"condition": real_condition}).round(3))

# %% [markdown]
# **How to read them.** Even rounds only: in odd ones the partner acts. Matches were ended at random by the experimenters,
# so the fall on the right is the design, not people who left; it is also why intervals widen. In the table, `bcB_eN` is
# a benefit of `B` times the cost and an error in one of `N` acts (`e0`: none). At the same error, cooperation is lowest
# where it pays least (`bc1.5`), and with errors absent or rarer it is higher. **What not to conclude:** that people
# become less willing *because of* the rounds: later rounds exist only in matches that lasted, and both players answered
# to what the other had done.

# %% [markdown]
# ## Participant flow

# %%
wb.flow_table(study.log)

# %%
if real is not None:
    display(wb.flow_table(real.log).drop(columns="short_runs"))

# %% [markdown]
# In the simulated study every run has five rounds and nothing is missing, which no real study manages. In the real data
# a person has several runs (*matches*), so whoever holds out data for a test must hold out **people**, not runs.

# %% [markdown]
# ## Your own file
#
# A raw export becomes an event log through a *column map*: a TOML file that names the columns and values. The template
# `data/maps/osf_study1_example.toml` is used here as it is, on an export of two made-up people.

# %%
EXPORT = """prolific_id,round,opportunity,help_arm,signal_arm,robot_helped,robot_signalled,human_helped,browser
5f3a,1,H,help,no-signal,,0,1,x
5f3a,2,R,help,no-signal,1,,,x
5f3a,3,H,help,no-signal,,0,NA,x
9c0d,1,R,no-help,signal,0,,,y
9c0d,2,H,no-help,signal,,1,0,y
"""
COLUMN_MAP = wb.DATA_FOLDER / "maps" / "osf_study1_example.toml"


def imported_from(text):
    """Import in a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        Path("export.csv").write_text(text, encoding="utf-8")
        Path("map.toml").write_text(COLUMN_MAP.read_text(encoding="utf-8"), encoding="utf-8")
        return wb.import_events("export.csv", "map.toml")


# %%
imported = imported_from(EXPORT)
print(*imported.notes)
imported.log.to_frame()

# %% [markdown]
# The letters were converted (`H` is `robot_needs_help`), rounds count from 0, `NA` became `missing`, and the personal
# ids are gone. A value that the map does not know is not guessed at:

# %%
try:
    imported_from(EXPORT.replace("9c0d,2,H", "9c0d,2,X"))
except wb.EventLogError as error:
    print(error)

# %% [markdown]
# ## What the real data are not
#
# Real people are not enough to answer the question of the paper. In the words of the data's own card:

# %%
if real is not None:
    display(Markdown("\n".join(f"- {item}" for item in real.card.what_not)))

# %% [markdown]
# So these data can test the *machinery* on people who were not drawn from the model: do searches agree, are states
# ordered, are intervals honest.
#
# ## What to take along
#
# | question | where the answer stands |
# |---|---|
# | is my file in order? | reading it is the check; every complaint names line and column |
# | how much data is it for learning? | distinct histories, not people |
# | whose data is this? | the card, and the line at the foot of every figure |
# | what may be held out for a test? | people, never runs |
#
# ## What not to conclude
#
# - That the real people say what a robot's help does. No robot was there, and no partner was assigned by chance.
# - That the simulated people say it. Their study holds what was put into it, and whoever finds an effect there has found
#   this project's own.
# - That a file which is read without a complaint is a good study. It is a consistent one.
#
# Next: [Baum-Welch and its traps](03_baum_welch_and_its_traps.ipynb) learns from both.
