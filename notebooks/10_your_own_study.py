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
# # Your own study, from your own file to a decision
#
# **The question.** You have run an experiment and hold its export: odd column names, people who left, answers that were not
# recorded. What should your robot do with the next person, how sure is that, and is another study worth its money?
#
# **The data.** An export as a browser experiment gives it, of 240 warehouse pickers and a delivery robot. It is *simulated*:
# nobody took part, and the cell under "The file" that plays nature is the one to delete when you have a file of your own.
# Everything after it is what you would do.
#
# **The model.** That of [notebook 01](01_the_model.ipynb), with another protocol. In round $k$ it is known who needs
# help; the robot does $a_k$; where it is the one in need, the person responds; and only then the person's hidden state
# moves:
#
# $$o_k \sim O(\cdot \mid s_k, a_k), \qquad s_{k+1} \sim T(\cdot \mid s_k, a_k), \qquad R(s, a) = v_s - v_0 - C_a.$$
#
# $T$, $O$ and the first belief $b_0$ are learned with their doubt. What a round is worth, $v_s$, is measured in *your* unit,
# and what an action costs, $C_a$, you have to say.

# %% tags=["parameters"]
FAST = False
SEED = 1

# %%
import tempfile
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

import analysis.workbench as wb

kept = tempfile.TemporaryDirectory()  # files of this notebook, gone when it ends; yours lie where you put them
folder = Path(kept.name)

# %% [markdown]
# ## The protocol: what can happen in a round
#
# The first thing to write down is not about data. Who may be in need, what can the robot do then, what can people answer,
# and what does each action cost? Here the robot sometimes passes a picker with a heavy box (letter `P`) and may *carry*
# it; and sometimes it is stuck (`S`) and may *wait*, *ask* for a push, or ask and *thank* for it. Costs are in points,
# the study's own unit: what the robot could have collected in the time.

# %%
PROTOCOL = """
name = "warehouse"

[modes.picker_in_need]
letter = "P"
actions = { pass = 0.0, carry = 6.0 }
null_action = "pass"
shows_response = false

[modes.robot_stuck]
letter = "S"
actions = { wait = 0.0, ask = 1.0, thank = 2.0 }
null_action = "wait"
shows_response = true

[responses]
drive_on = 0.0
push = 1.0
"""
(folder / "protocol.toml").write_text(PROTOCOL)
protocol = wb.Protocol.from_toml(folder / "protocol.toml")

# %% [markdown]
# ## The file
#
# **Nature.** Three kinds of people, whom carrying and thanking make more willing and asking wears out (the tables are in
# `analysis/warehouse.py`). Six arms: within a person the robot always does the same in a mode, as in most such experiments.
# Eight rounds, in one of two orders. The export has codes instead of names and one row for *every* round of everybody, empty
# after a person has closed the tab; a few answers are lost, and two rounds were sent twice because somebody reloaded the
# page. A push lets the team go on collecting, which is some 30 points.

# %%
rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(10,)))
truth = wb.warehouse_truth(protocol)
raw = wb.raw_export(wb.pickers(truth, 240, rng), rng)
raw.to_csv(folder / "all_apps_wide_export.csv", index=False)
raw.head(6)

# %% [markdown]
# ## The column map
#
# A TOML file says which column is which and what the codes mean. Nothing else about the export is assumed.

# %%
COLUMN_MAP = """
study = "warehouse pilot (SIMULATED)"
first_round = 1
missing = [""]

[columns]
participant = "participant.code"
condition = ["session.config.arm_shelf", "session.config.arm_stuck"]
k = "subsession.round_number"
mode = "player.turn"
action = "player.bot_did"
observation = "player.clicked"
team_tokens = "player.points"

[values]
mode = { SHELF = "picker_in_need", STUCK = "robot_stuck" }
observation = { 1 = "push", 0 = "drive_on" }

[values.action]
PASS = "pass"
CARRY = "carry"
WAIT = "wait"
ASK = "ask"
THANK = "thank"
"""
(folder / "map.toml").write_text(COLUMN_MAP)


def imported(name):
    with chdir(folder):
        return wb.import_events(name, "map.toml", protocol)


# %% [markdown]
# ## It is refused, and says why
#
# No row is guessed at and none is left out silently, so a first import hardly ever goes through:

# %%
try:
    imported("all_apps_wide_export.csv")
except wb.EventLogError as error:
    print(f"{error.total} problems in the columns {sorted({p.column for p in error.problems})}, the first of them:")
    print(*error.problems[:3], sep="\n")

# %% [markdown]
# Line, column, what was found and what was wanted. These rounds were never played, by people who had left: the export
# writes a row for them, the event log must not. An event that nobody lived through is no event, and no missing response
# either. Mend the file by a rule that you can write into the paper, and count what it takes away.

# %%
played = raw[raw["player.bot_did"] != ""]
print(f"rounds never played: {len(raw) - len(played)}")
played.to_csv(folder / "played.csv", index=False)
try:
    imported("played.csv")
except wb.EventLogError as error:
    print(*error.problems, sep="\n")

# %% [markdown]
# Two rounds were sent twice. The two copies are equal in every column, so one of each goes; had they differed, somebody
# would have to decide which of them was lived through.

# %%
once = played.drop_duplicates()
print(f"rows sent twice, equal in every column: {len(played) - len(once)}")
once.to_csv(folder / "once.csv", index=False)
result = imported("once.csv")
for note in result.notes:
    print("note:", note)
with chdir(folder):
    wb.write_events(result.log, "study.csv.gz")
    Path("key.csv").write_text(
        wb.key_text(result.key)
    )  # who is who: keep it apart from the study, or do not write it

# %% [markdown]
# The same from a terminal:
#
# ```sh
# prosocial data import once.csv --map map.toml --protocol protocol.toml --out study.csv.gz --key key.csv
# prosocial data check study.csv.gz --protocol protocol.toml
# ```
#
# Reading the event file *is* the check. A file does not say whether its people exist; say it, and every figure and report
# says it too.

# %%
with chdir(folder):
    own = wb.load("study.csv.gz", protocol)
own = replace(own, card=replace(
    own.card, kind="simulated", title="Warehouse pilot (SIMULATED)", run_length="fixed",
    what="240 simulated pickers and a robot that carries, waits, asks or thanks.",
    what_not=("Evidence about people: nobody took part.",),
))  # fmt: skip
log = own.log
print(log)
log.to_frame().drop(columns=["study", "sequence"]).head(4)

# %% [markdown]
# ## Who took part, and who responded how

# %%
wb.flow_table(log)

# %%
leaving = wb.dropout_after_response(log)
print(leaving.sentence if leaving else "Nobody left early, or there is nothing to compare.")
arm_of = pd.Series(log.condition_of_event).str.split("+", expand=True)
cells = wb.response_rates(log, {"box": arm_of[0].to_numpy(), "when stuck": arm_of[1].to_numpy()})
cells.round(3)

# %%
left, middle, right = wb.panels(4.3, 3.1, 2.7, height=3.3)
wb.plot_still_going(wb.still_going(log), ax=left)
order = {"row_order": ["PASS", "CARRY"], "column_order": ["WAIT", "ASK", "THANK"]}
wb.rate_heat_map(cells, rows="box", columns="when stuck", limits=(0, 1), **order, ax=middle)
wb.rate_by_round(wb.response_rates(log, {"k": log.k}), measure="push rate", limits=(0, 1), last_round=7, ax=right)
wb.show(
    left, own.card.kind,
    "Left: share of people who played each round, by arm. Middle: share of pushes by arm. Right: by round, all arms, with "
    "95% intervals.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Carrying raises pushes in every column; of what the robot does when stuck less can be said. Leaving
# is the first threat to everything below. The model treats what is missing as missing at random *given the history*:
# people may leave after refusing, but not because of a mood that left no trace. Compare arms too: a robot that drives
# people away looks good to those who stay. **What not to conclude:** that a flat line by round means that nobody changes.
# Arms are mixed in it.
#
# Arms were assigned by chance, so differences between them are effects, and no model has to be believed for that. They
# answer one question only: what does *always the same* do? What to do with somebody who has just refused is a question
# about changes within people, and needs the model.
#
# ## How many states?
#
# What [notebook 03](03_baum_welch_and_its_traps.ipynb) left open, decided by prediction: of *people* whom the models have
# not seen.

# %%
sampler = wb.NutsSettings(200, 200, 2, SEED) if FAST else wb.NutsSettings(seed=SEED)
digest = wb.log_digest(log)
settings = wb.CompareSettings(
    restarts=20 if FAST else 60, finalists=5, sampler=sampler, types=(2,), folds=5 if FAST else 10, seed=SEED,
    evidence=wb.SmcSettings(100 if FAST else 200, 2, moves=2, seed=SEED),
    moves=wb.SmcSettings(60 if FAST else 200, moves=2, seed=SEED),
)  # fmt: skip


def learn(k, held, people):
    return wb.stored_fit(log, digest, k, pins=held, people=people, sampler=sampler).posterior


# %%
compared = wb.compare(log, (2,) if FAST else (2, 3), settings=settings, learn=learn)
print(compared.sentence)
for warning in compared.warnings:
    print("warning:", warning)

# %%
best_by = {}
for criterion, models in compared.indistinct().items():
    best_by.setdefault(models[0], []).append(wb.CRITERIA[criterion])
wb.show(
    wb.elpd_differences(compared.table, best_by), own.card.kind,
    "How much worse each model predicts people than the best one. *Types* are people who differ and never change.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Nature made *three* states and the criteria take two: 240 people with at most five responses each do
# not tell a middle state from a mixture of the others. That is no fault. The number of states is how fine a picture the
# data can carry, not a fact about people.
#
# Take the second half of the sentence as seriously as the first. *Two types* of people, who differ and never change, do
# nearly as well by these criteria. What speaks against types here is not a criterion, it is the design: types cannot
# explain why people push more often for a robot that carries, and the arms show that they do. A study without such arms
# would have to leave it open.
#
# And do not wave the warning away. The chains of *2 types* disagree about which of the two is which under *ask*, and they
# are right to: nobody was both asked and left waiting, so nothing in the file says that the willing type of one arm is
# that of another. States are tied together a little better, since all arms share the tables of *pass* and *carry*.
#
# ## The posterior, and its gate

# %%
posterior = learn(2, {}, None)
print(posterior.gate.sentence)
told = wb.contraction(posterior)
print(told.sentence)
wb.show(
    wb.contraction_dots(told.table, known=wb.KNOWN, partly=wb.PARTLY), own.card.kind,
    "How much the data say on each entry of the tables: at 0 an entry is its prior, near 1 it is the data.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Here the data speak on nearly every entry; with the published design and four states hardly any did
# ([notebook 04](04_how_sure_are_we.ipynb)). A gate that is shut is a stop sign, not a blemish: do not plan with such
# draws. Take more draws, fewer states, or both. **What not to conclude:** that a table far from its prior is right. It is
# what *this model* takes from the data.
#
# What one action changes, against leaving people alone in the same mode, at the next response:

# %%
changes = wb.contrasts(posterior)
drawn = [changes.table[changes.table["action"] == action] for action in ("carry", "ask", "thank")]
for ax, table in zip(wb.panels(4.1, 4.1, 4.1, height=2.4), drawn, strict=True):
    wb.contrast_by_state(
        table, scale=changes.scale, unit="percentage points", title=table["action"].iloc[0], limits=(-25, 35), ax=ax
    )
print(*map(changes.sentence_of, ("carry", "ask", "thank")), sep="\n")
wb.show(
    ax, own.card.kind, "Change of the chance of a push in the next round, by the state before. Grey: what the prior allowed.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Carrying moves people up, above all those who were not willing; what asking and thanking do to the
# *next* round is hardly told apart from nothing. **What not to conclude:** that they do nothing.
#
# ## What this study cannot say
#
# No posterior says where it rests on the model rather than on data. The design does:

# %%
fit = wb.BaumWelch(2, restarts=30 if FAST else 100, seed=SEED).fit(log)
print(*wb.identification(fit, log).sentences(), sep="\n")

# %% [markdown]
# The sentence on constant actions is the one to remember. In this file nobody was asked in one round and thanked in the
# next. A plan that does so is worth what the *model* says of it.
#
# ## What is a round worth?
#
# As the paper has it: the mean points of the team, rounds weighted by how probable each state was in them.
# `Reward.of_values` takes any unit, so long as it is that of the costs.

# %%
worth = wb.state_scores(fit.model, log)
names = ("reluctant", "willing")
draws = replace(posterior.draws(), state_names=names, reward=wb.Reward.of_values(worth, unit="points"))
if FAST:
    draws = draws.thin(200)
print({name: f"{points:.1f} points a round" for name, points in zip(names, worth, strict=True)}, protocol.costs)

# %% [markdown]
# ## A plan for the next person, under doubt
#
# Eight rounds, `PSSPSSPS`. Every draw of the posterior has its own best plan; one plan is best on average over all of them
# ([notebook 07](07_robust_planning.ipynb)). Every value is in points, the unit that the reward was given.

# %%
study = wb.Schedule.of(draws, "PSSPSSPS")
best_of_each = wb.own_plans(study)
plan = wb.solve_schedule(study)
stability = wb.decision_stability(study, plan)
share = best_of_each.shares[0]
print(f"{draws.n_draws} draws, {len(best_of_each.plans)} plans; the most common is best for {share:.0%}.")
print("Best on average:", " · ".join(wb.acting_words(study, plan.decisions)))
print(stability.sentence)

# %%
wb.show(
    wb.stability_tree(stability), own.card.kind,
    "Every decision of that plan, and the share of the draws that agree. Pushes upwards; bold frames act.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** The first decisions are shared by most draws; later ones, where two actions differ by little, by
# half of them. **What not to conclude:** that a decision with a share near one half is a bad one. Between such actions
# little is lost.

# %%
estimate = replace(fit.model, state_names=names, reward=draws.reward)
chains = None if FAST else posterior.gate.chains
prices = wb.price(study, wb.standard_candidates(study, plug_in=estimate), optima=best_of_each.values, chains=chains)
print(prices.sentence)
wb.show(
    wb.plan_comparison(prices), own.card.kind,
    "Plans side by side, in points a person. *Held-out*: chosen on other draws than those that score it.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Look at the plans in front, not at the one in front. Where several lie within a fraction of a point,
# take the one that you can explain to the people who will meet it. Here is what they do, and where the first decisions
# would flip were costs different (this matters, since costs are yours and no data stand behind them):

# %%
for name in ("Bayes-adaptive", "plug-in estimate", "fixed sequence"):
    print(f"{name}:", " · ".join(wb.acting_words(study, prices[name].chosen.plans[0])))
careful = wb.cautious_plan(study, 0.1)
for chosen, share in zip(careful.plans, careful.share, strict=True):
    print(f"cautious, {share:.0%}:", " · ".join(wb.acting_words(study, chosen)))
for flip in wb.flip_points(study):
    print(flip.sentence)

# %% [markdown]
# ## Is another study worth it?
#
# Two that could be run next, of six rounds each: the same six arms again, or a robot that draws its action anew in every
# round. Suppose a thousand people will meet the robot afterwards, and a participant costs what 10 points are worth.

# %%
perfect = wb.perfect_information(study, chains=chains)
print(perfect.sentence)
again = [wb.Arm.constant(protocol, "PSSPSS", dict(zip(protocol.mode_names, arm, strict=True))) for arm in wb.ARMS]
nexts = [
    wb.NextStudy.of_arms("the same six arms", again),
    wb.NextStudy.of_arms("actions drawn in every round", [wb.Arm.random(protocol, "PSSPSS")]),
]

# %%
data_worth = wb.sample_information(
    study, nexts, (60, 120) if FAST else (60, 120, 240, 480), replicates=10 if FAST else 60, seed=SEED, perfect=perfect,
    served=1000, cost=10,
)  # fmt: skip
print(data_worth.sentence)
best = data_worth.best
needed = 10 * best.people / best.sure if best.sure > 0 else float("inf")
print(
    f"At {best.sure:.2g} points a person, as in that sum, "
    f"{best.people} participants pay from {needed:,.0f} people served on."
)

# %%
wb.show(
    wb.information_by_people(data_worth), own.card.kind,
    "What further participants would be worth, in points for each person who meets the robot later. Dashed: perfect knowledge.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** The sum in all and the people needed go by the smaller of the two estimates, the one that is sure. A
# participant for whom actions vary teaches more than one for whom they never do. Bands reach down to what is left on draws
# that did not choose the plan; hollow points say that the draws are too few to tell.
#
# **What not to conclude:** that data are worth no more than this. It is their worth *for this decision*, *within this
# model*. Whether actions that vary within a person do what the model says is a reason of its own to run the second kind
# of study, and no sum of points counts it.
#
# ## The report of this study
#
# What others will read. An analysis plan says what was planned before anybody looked; everything else is marked exploratory.

# %%
PLAN = """
title = "Boxes and pushes"
date = 2026-03-01

[[planned]]
results = ["study", "states"]
why = "H1: people push more often after the robot has carried for them. H2: willingness changes."
"""
(folder / "plan.toml").write_text(PLAN)
brief = [entry for entry in wb.SECTIONS if entry.key in ("provenance", "study", "flow", "states", "limits")]
with chdir(folder):
    report = wb.build_report(
        own, states="2" if FAST else "2,3", seed=SEED, quick=True, out="report", plan=wb.read_analysis_plan("plan.toml"),
        parts=not FAST, reward=wb.Measured(unit="points"), schedule="PSSPSSPS", sections=brief if FAST else wb.SECTIONS,
    )  # fmt: skip
print("made:", ", ".join(section.title for section in report.sections if not section.omitted))
for section in report.sections:
    if section.omitted:
        print(f"left out: {section.title}: {section.omitted}")

# %% [markdown]
# What is left out is left out for a reason that is printed: the paper's own studies and game have nothing to say on boxes
# and pushes, and quick reports skip what takes minutes. Plans are in it because a round has a worth here, the measured one
# of above. For yourself: no `quick`, and
#
# ```sh
# prosocial report --data study.csv.gz --protocol protocol.toml --plan plan.toml --run-length fixed \
#     --values measured --unit points --schedule PSSPSSPS
# ```
#
# ## Does another study say the same?
#
# A second site, 120 *simulated* people, the same arms. (Nature once more: the same truth, so nothing should differ.)

# %%
elsewhere = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(11,)))
with chdir(folder):
    wb.write_events(wb.pickers(truth, 120, elsewhere), "second_site.csv.gz")
    sides = wb.compare_report(
        "study.csv.gz", "second_site.csv.gz", protocol=protocol, states="2", schedule="PSSPSSPS", seed=SEED, quick=True,
        out="report", parts=False,
    )  # fmt: skip
for section in sides.sections:
    if section.key in ("responses", "tables", "one-model"):
        print(f"{section.title}: {' '.join(section.sentences)}")

# %% [markdown]
# (`prosocial report --compare study.csv.gz second_site.csv.gz --protocol protocol.toml --states 2` from a terminal.) That
# nothing was found to differ is not that nothing differs: intervals say how large a difference could have gone unseen.
#
# ## What nature would say
#
# This cell you will not have. The plans, made from an export of 240 people and with two states instead of three, are
# valued in the truth that made the people:

# %%
true_reward = wb.Reward.of_values(wb.state_scores(truth, log), unit="points")
true_study = wb.Schedule.of(wb.ModelDraws.from_models([replace(truth, reward=true_reward)]), "PSSPSSPS")
ours = wb.PlanPolicy.of(plan, "our plan", left="follow")
made = {
    policy.name: wb.evaluate_schedule(policy, true_study).value
    for policy in (ours, wb.never(protocol), wb.always(protocol))
}
made["best plan, were the truth known"] = wb.solve_schedule(true_study).value
pd.Series(made).rename("points a person, in truth").round(2).to_frame()

# %% [markdown]
# ## What to take along
#
# | before you | look at |
# |---|---|
# | believe the file | the import's complaints, and how many rows each rule of yours took away |
# | believe a difference | arms that were assigned by chance; everything else is a model's word |
# | believe a number of states | models that predict people they have not seen |
# | believe a table | the gate, then contraction, then what the design cannot say |
# | believe a plan | how many draws agree, and what the next best plans lose |
# | pay for more data | what they would be worth for the decision at hand |
#
# ## What not to conclude
#
# - Anything about pickers: there were none.
# - That the plan in front is *right*: costs and what a round is worth were put in by hand, and within a person the robot never
#   changed what it did.
# - That people come in two kinds, because two states predicted best; or that a state is a trait, a mood, or anything that
#   somebody could be told about themselves.
# - That a robot *should* do what moves people most: whoever is carried for in order to push more has a right to know it.
#
# This is the last of ten. Next: your own file; and where a step is unclear, [the model](01_the_model.ipynb) again.
