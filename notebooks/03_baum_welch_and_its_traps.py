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
# # Baum-Welch and its traps
#
# **The question.** The paper learns its tables with expectation maximisation (Baum-Welch), tries 2 to 5 latent states
# with 30 random restarts each, and keeps 4 because the log-likelihood was highest there. What can go wrong on the way,
# and how would one notice?
#
# **The data.** Mostly the *simulated* study of the workbench, where the truth is known; at the end the *real* people of
# Fudenberg, Rand and Dreber (2012), both as in [notebook 02](02_real_data_and_the_event_log.ipynb). The authors' own
# data are in neither.
#
# **The model.** That of [notebook 01](01_the_model.ipynb). A run of $K$ rounds with actions $a_k$ and responses $o_k$ has
# the likelihood
#
# $$L = \sum_{s_0, \ldots, s_{K-1}} b_0(s_0) \prod_{k=0}^{K-1} e_k(s_k) \prod_{k=0}^{K-2} T(s_{k+1} \mid s_k, a_k),$$
#
# where $e_k(s) = O(o_k \mid s, a_k)$ if a response was seen and $1$ otherwise. One step of EM computes how often each
# transition and response is expected to have happened, given the current tables, and takes the shares as new tables. No
# step lowers the likelihood; where the steps lead is another matter.

# %% tags=["parameters"]
FAST = False
SEED = 1

# %%
from dataclasses import replace

import numpy as np
import pandas as pd

import analysis.workbench as wb

# %%
RESTARTS, FINALISTS, REPLICATES = (20, 5, 20) if FAST else (200, 30, 200)
log = wb.load("simulated_study1").log
truth = wb.calibrated_truth()
help_column = wb.PUBLISHED.response_names.index("help")
log

# %% [markdown]
# ## Trap 1: many optima
#
# The likelihood has many local maxima, and EM climbs the hill it starts on. The workbench runs 200 short climbs, then
# the best 30 to the top (*longer search*). Beside it the *published procedure*: 30 climbs, stopped after 1,000 steps
# (the paper prints neither a cap nor a tolerance; these are the usual ones).

# %%
study = wb.run_em(
    log, (2, 3, 4, 5), with_paper=True, seed=SEED,
    settings=lambda k: wb.BaumWelch(k, restarts=RESTARTS, finalists=FINALISTS, seed=SEED),
)  # fmt: skip
for fit in study.fits.values():
    print(fit.sentence)

# %%
axes = wb.panels(3.1, 3.1, 3.1, height=2.8)
for ax, k in zip(axes, (2, 3, 4), strict=True):
    wb.optima(study.fits[k], study.paper_fits[k], ax=ax)
wb.show(
    axes[0],
    "simulated",
    "Where restarts ended, in nats below the best found. Above the line the longer search, below it the published one.",
)

# %% [markdown]
# **How to read it.** With 2 states nearly all climbs meet at one top. With 3 and 4 they scatter: most end somewhere
# lower, at other tables with another story. **What not to conclude:** that the leftmost bar is the global maximum. It is
# the best that was *found*; when one or two climbs of thirty reach it, more climbs may find a better one.

# %% [markdown]
# ## Trap 2: slow convergence that looks like convergence
#
# Plain EM crawls along flat ridges. The same three starting points, once with plain EM and once with extrapolated steps
# (SQUAREM, guarded so that the likelihood never falls):

# %%
cap = 3_000 if FAST else 20_000
one_climb = wb.BaumWelch(3, restarts=1, finalists=None, screening_maps=0, max_maps=cap, tolerance=1e-9)
climbs = {}
for start in (1, 2, 3):
    for name, accelerate in (("plain", False), ("accelerated", True)):
        climbs[start, name] = replace(one_climb, accelerate=accelerate, seed=start).fit(log)
pd.DataFrame(
    {"start": start, "EM": name, "maps": fit.maps, "converged": fit.converged, "log-likelihood": fit.log_likelihood}
    for (start, name), fit in climbs.items()
).round(3)

# %% [markdown]
# And where would plain EM have ended under the usual rules: stop when one step gains less than $10^{-5}$, or after 1,000
# steps?

# %%
for start in (1, 2, 3):
    trace = climbs[start, "plain"].trace
    stop = int(np.argmax(np.diff(trace) < 1e-5))
    print(f"start {start}, {len(trace) - 1:,} steps: a gain below 1e-5 stops it after {stop:,}, which is", end=" ")
    print(
        f"{trace[-1] - trace[stop]:.3f} nats short; the cap after 1,000 is {trace[-1] - trace[1000]:.3f} nats short"
    )

# %%
axes = wb.panels(3.2, 3.2, 3.2, height=2.9)
labels = {"xlabel": "EM maps", "ylabel": "nats below the end", "log_x": True, "log_y": True}
for ax, start in zip(axes, (1, 2, 3), strict=True):
    own = {name: climbs[start, name] for name in ("plain", "accelerated")}
    top = max(fit.log_likelihood for fit in own.values())
    lines = {
        name: (np.linspace(0, fit.maps, len(fit.trace)) + 1, top - fit.trace + 1e-4) for name, fit in own.items()
    }
    wb.curves(lines, title=f"start {start}", ax=ax, **labels)
wb.show(
    axes[0], "simulated", "Climbs with 3 states. Both axes are logarithmic; $10^{-4}$ was added to show the end itself.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Flat stretches are ridges: for hundreds of maps next to nothing is gained, and then the climb goes
# on. The tolerance does little harm here, but it is never reached before the usual cap, and a climb that is cut off in
# mid-ridge looks just like one that has arrived. The workbench counts a run as converged only after ten steps in a row
# that gain less than $10^{-8}$, and says so otherwise. **What not to conclude:** that acceleration finds better optima.
# It gets to *an* optimum sooner; all three starts end below the best that the longer search found ("3 states" above).

# %% [markdown]
# ## Trap 3: "the log-likelihood was highest at 4 states"
#
# A model with 5 states contains every model with 4: make one state a copy. So the *maximum* of the likelihood cannot
# fall when a state is added.

# %%
left, right = wb.panels(4.4, 4.4, height=3.3)
own = {k: fit.log_likelihood for k, fit in study.fits.items()}
published = {k: fit.log_likelihood for k, fit in study.paper_fits.items()}
wb.log_likelihoods(own, published, None, ax=left)
wb.information_criteria(
    {k: fit.bic for k, fit in study.fits.items()}, {k: fit.aic for k, fit in study.fits.items()}, ax=right
)
wb.show(left, "simulated", "Left: the paper's criterion. Right: criteria that charge for parameters.")
print(study.restarts_sentence)

# %% [markdown]
# **How to read it.** On this simulated study even the published procedure is highest at 5; criteria that charge for
# parameters prefer 2, although *the truth has 4 states*: 540 people with three responses each are not enough to see them
# all. **What not to conclude:** that 5 is right, or 2.
#
# How could one see a peak at 4 all the same? On the people that the tables were fitted to, only if restarts with 5 states
# stop short of their maximum by more than restarts with 4 do. How probable is that? From a few hundred climbs at each
# number of states, the chance that the best of $n$ climbs with 5 states is *below* the best of $n$ climbs with 4 follows by
# counting; climbs are stopped after 50, 200 or 1,000 steps.

# %%
climbing, numbers = 40 if FAST else 200, (1, 2, 3, 5, 10, 20, 30)
luck = {}
for cap in (50, 200) if FAST else (50, 200, 1000):
    four, five = (wb.climb_ends(log, k, climbing, cap, SEED) for k in (4, 5))
    luck[f"{cap:,} steps"] = (numbers, wb.chance_ahead(four, five, numbers))
wb.show(
    wb.curves(luck, xlabel="restarts at each number of states", ylabel="chance that 4 beats 5 states"), "simulated",
    "How often too few restarts make 4 states look better than 5, although the maximum is higher at 5.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** A lone short climb puts 4 above 5 in about one case of four; thirty full climbs practically never
# on these data. Where 4 states *exceed* 5 on the people that both were fitted to, a search stopped short: a low cap, a loose
# tolerance, too few starting points, whatever the data. Two things look like such a peak and are none. At a *tie* 5 states
# add nothing, and whoever reports the smaller number is right to. And the log-likelihood of *people held out* may well fall
# with more states: a peak there is a finding. **What not to conclude:** that a search stopped short wherever 4 is reported;
# ask first which people were scored, and by how much. Nor that the authors' data would behave like this study.

# %% [markdown]
# ## Trap 4: estimates on the boundary

# %%
errors = {k: wb.standard_errors(fit, log) for k, fit in study.fits.items()}
pd.DataFrame(
    {
        "states": k,
        "free parameters": fit.n_parameters,
        "free entries at 0 or 1": study.identifications[k].on_boundary,
        "largest standard error": errors[k].largest,
    }
    for k, fit in study.fits.items()
).set_index("states")

# %% [markdown]
# **How to read it.** With more states, most entries end at exactly 0 or 1. That is what maximum likelihood does with few
# data, not evidence that something is impossible. Standard errors come from the curvature of the likelihood at an
# interior maximum, so entries on the boundary get none and are taken as *known* in those of the others. **What not to
# conclude:** that the last column is how uncertain the tables are. It is how uncertain the few others are if 0 and 1 are
# exactly right; [notebook 04](04_how_sure_are_we.ipynb) does better.

# %% [markdown]
# ## Trap 5: which state is which?
#
# Permuting the states leaves the likelihood as it is, so labels are a convention. The workbench orders states by their
# expected response (here: the probability to help, averaged over actions by how often they were seen). The paper orders
# by "transition structure and stability". For the 4-state fit:

# %%
model = study.fits[4].model
score = wb.expected_score(model.emission, wb.PUBLISHED.scores, study.fits[4].emission_weights)
order = pd.DataFrame({"start": model.initial, "help rate": score}, index=model.state_names)
for action in wb.PUBLISHED.action_names:
    table = model.transition[wb.PUBLISHED.action(action)]
    order[f"{action}: stationary"], order[f"{action}: dwell"] = (
        wb.stationary_distribution(table),
        wb.dwell_time(table),
    )
order.round(2)

# %%
for action in wb.PUBLISHED.action_names:
    dwell = wb.dwell_time(model.transition[wb.PUBLISHED.action(action)])
    print(f"by dwell time under {action}:", " < ".join(f"s{i}" for i in np.argsort(dwell, kind="stable")))

# %% [markdown]
# **How to read it.** Stationary: the long-run share of rounds if the action were always taken. Dwell: rounds until the
# state is left (infinite: never). Each action gives another order by stability, none of them the order by response.
# **What not to conclude:** that a name such as "mid-prosocial" means the same thing in two papers, or in two fits.

# %% [markdown]
# ## Trap 6: what the design cannot tell
#
# In a schedule such as `HRHRH` the person's response shows in every other round. Between two responses the state makes
# two moves, one under the robot's action in the `H` round and one under its action in the `R` round, and only their
# product enters the likelihood:
#
# $$T(a_H)\, T(a_R) = \underbrace{T(a_H)\, Q}_{\text{other table}}\; \underbrace{Q^{-1}\, T(a_R)}_{\text{other table}}
# \quad\text{for any } Q \text{ that leaves both stochastic.}$$
#
# Let us make three models of it, from the 2-state fit: as fitted; with all change moved into the rounds in which the
# robot can help ($Q = T(\text{no signal})^{-1}$); and one in which the two states trade places after every `H` round and
# back after every `R` round.

# %%
no_signal, pair = wb.PUBLISHED.action("no_signal"), [wb.PUBLISHED.action(a) for a in ("no_help", "help")]
fitted, trade = study.fits[2].model, np.eye(2)[::-1]
pushed, swapped = fitted.transition.copy(), fitted.transition.copy()
pushed[no_signal], swapped[no_signal] = np.eye(2), fitted.transition[no_signal] @ trade
pushed[pair] = fitted.transition[no_signal] @ fitted.transition[pair]
swapped[pair] = trade @ fitted.transition[pair]
stories = {
    "as fitted": fitted,
    "all in the robot's help": replace(fitted, transition=pushed),
    "states trade places": replace(fitted, transition=swapped),
}

# %%
silent = log.select(conditions=["help+no-signal", "no-help+no-signal"])
alternating = silent.select(runs=silent.schedules() == "HRHRH")
rows = {}
for name, model in stories.items():
    acted = ("no_help", "help", "no_signal")
    staying = {f"{a}: s1 → s1": model.transition[wb.PUBLISHED.action(a), 1, 1] for a in acted}
    rows[name] = staying
    for label, part in (("only HRHRH", alternating), ("all six schedules", silent)):
        tree, tables = part.tree(), (model.initial, model.transition, model.emission, model.emission_index)
        count = tree.arrays.ends[tree.terminals]
        rows[name][f"log-likelihood, {label}"] = wb.history_log_likelihoods(tree, *tables) @ count
pd.DataFrame(rows).round(6)

# %% [markdown]
# **How to read it.** Three different stories about what helping does; on `HRHRH` their likelihoods agree to the last
# digit shown, so no amount of such data can choose. Schedules in which a mode repeats (`RRHHH`, `HHRRH`, ...) tell them
# apart. The same in general: how many directions in parameter space the histories of a design can tell apart (the rank
# of their scores), all four conditions, with enough people that every history occurs.

# %%
many = wb.simulate_study1(participants=20_000, seed=SEED)
wb.schedule_ranks(many, (2, 3, 4), SEED)

# %% [markdown]
# **How to read it.** Read "11 of 13" as: two directions along which the tables can slide with the likelihood unchanged.
# With all six schedules nothing slides, even with 4 states. (The nine-round `HRHRHRHRH` of the paper's second study
# alternates as well.) **What not to conclude:** full rank says that *infinitely many* people would tell, not that 540 do.
# The workbench prints such warnings with every fit:

# %%
every = log.select(runs=log.schedules() == "HRHRH")
alone = wb.BaumWelch(2, restarts=RESTARTS, finalists=FINALISTS, seed=SEED).fit(every)
for sentence in wb.identification(alone, every).sentences():
    print("-", sentence)

# %% [markdown]
# ### Pinning, and that it is not innocent
#
# The way out is to *decide* one table: "nothing happens while the robot stays silent", $T(\text{no signal}) = I$. Where
# nobody signals, every likelihood on alternating data can still be reached (that is the second story above), and the
# flat directions are gone:

# %%
layout, pin = wb.Layout(wb.PUBLISHED, 2), {"no_signal": np.eye(2)}
print("directions told apart on HRHRH: free", wb.score_rank(every, layout, {}, seed=SEED), "of", alone.n_parameters)
print("pinned", wb.score_rank(every, layout, pin, seed=SEED), "of", alone.n_parameters - 2)

# %% [markdown]
# But what the state does in rounds in which nothing is seen has consequences: the reward counts there too.

# %%
x = fitted.reward.prosocial()
worth = {}
for name in ("as fitted", "all in the robot's help"):
    belief, values = fitted.initial, []
    for mode in wb.PUBLISHED.modes_from_letters("HRHRHRHRH"):
        values.append(belief @ x)
        belief = stories[name].update(belief, "no_signal" if mode.shows_response else "help")
    worth[name] = values
frame = pd.DataFrame(worth, index=[f"{i}: {letter}" for i, letter in enumerate("HRHRHRHRH")])
frame.loc["sum"] = frame.sum()
frame.round(2).T

# %% [markdown]
# **How to read it.** Expected reward of the state (reward units; one act of helping costs 15), round by round, if the
# robot always helps and never signals. In `H` rounds, where responses show, the two agree; in `R` rounds they do not. No
# datum chose between them; the pin did.

# %% [markdown]
# ## How sure? Bootstrap intervals beside the truth
#
# The parametric bootstrap draws new studies from the fit, refits each and puts states back into order. On simulated data
# we can look whether the truth lies inside. First a world with **two** states (the 2-state fit, pulled a little away from 0
# and 1, is now taken as truth, and a new study drawn from it), then the bundled study, whose truth has **four**.

# %%
inner = replace(fitted, transition=0.9 * fitted.transition + 0.05)
two = wb.simulate_study1(truth=inner, participants=540, seed=SEED + 1, study="simulated_two_states")
cases = {"two": (two, inner), "four": (log, truth)}
boots = {}
for name, (part, source) in cases.items():
    fit = wb.BaumWelch(source.n_states, restarts=RESTARTS, finalists=FINALISTS, seed=SEED).fit(part)
    quick = replace(fit, settings=replace(fit.settings, max_maps=2_000, tolerance=1e-6))
    boots[name] = fit.model, wb.bootstrap_fit(quick, part, REPLICATES, seed=SEED)

# %%
for name, (estimate, bootstrap) in boots.items():
    source = cases[name][1]
    inside = wb.shares_inside(bootstrap, source)
    wb.show(
        wb.bootstrap_beside_truth(estimate, bootstrap, source), "simulated",
        f"A truth of {name} states, 540 people: estimates, 90% bootstrap intervals ({REPLICATES} replicates) and truth. "
        f"Of all response entries {inside['emission']:.0%}, of all transition entries {inside['transition']:.0%} have "
        "the truth inside.",
    )  # fmt: skip

# %% [markdown]
# **How to read it.** With two states the bars are short, most diamonds lie in them and the others near: this can be
# learned from 540 people. With four, the truth is inside because the bars span nearly everything, while many estimates
# (dots) sit at 0 or 1, far from it: the interval tells what the table of estimates hides, that nothing was learned about
# most moves. **What not to conclude:** how often such intervals contain the truth. That takes many studies, not one; and
# the bootstrap trusts its own fit, so where the fit sits in a corner it can miss with confidence (`no signal, s3`).

# %% [markdown]
# ## Would more people help?
#
# Everything works on distinct histories, so a study of half a million people costs what 540 cost. Mean error of all
# transition entries, for both truths:

# %%
sizes = (540, 5_400, 54_000) if FAST else (540, 5_400, 54_000, 540_000)
truths = {f"{source.n_states} states": source for source in (inner, truth)}
search = wb.BaumWelch(2, restarts=RESTARTS // 2, finalists=max(FINALISTS // 3, 3), seed=SEED)
found = wb.error_by_people(truths, sizes, search, SEED + 2)
error = {name: (sizes, off) for name, off in found.items()}
wb.show(
    wb.curves(error, xlabel="people", ylabel="mean error of a transition entry", log_x=True, log_y=True),
    "simulated",
    "Distance of the estimated transition tables from the truth that the studies were drawn from.",
)

# %% [markdown]
# **How to read it.** Falling by half a decade for every decade of people is textbook learning, and two states follow it.
# Four states learn far less from a thousandfold. **What not to conclude:** that people have two states, or that four are
# wrong. Three responses a person are too few to see four.

# %% [markdown]
# ## Real people
#
# The data of Fudenberg, Rand and Dreber alternate strictly and have no signalling arm, so $T(\text{no signal})$ is
# pinned to the identity, as their card says. Condition `bc4_e8`, 90 people, 2 to 4 states.

# %%
try:
    real = wb.load("frd2012")
except wb.InputError as failure:
    real = None
    print(f"{wb.ABSENT}: the cells on frd2012 are skipped. {failure}")

# %%
if real is not None:
    part = real.log.select(conditions=[real.card.defaults["condition"]])
    pins = dict.fromkeys(real.card.defaults["pins"])  # None: held at the identity
    people = wb.run_em(
        part, (2, 3, 4), seed=SEED,
        settings=lambda k: wb.BaumWelch(k, restarts=RESTARTS, finalists=FINALISTS, pins=pins, seed=SEED),
    )  # fmt: skip
    for fit in people.fits.values():
        print(fit.sentence)
    unpinned = wb.BaumWelch(2, restarts=RESTARTS // 2, finalists=FINALISTS, seed=SEED).fit(part)
    print(f"Not pinned, {unpinned.sentence}")

# %% [markdown]
# Pinning costs nothing in likelihood (compare the last line with the first): the data cannot object.

# %%
if real is not None:
    axes = wb.panels(3.0, 3.5, 4.0, height=3.2)
    for ax, (k, fit) in zip(axes, people.fits.items(), strict=True):
        curve = {"no_signal": fit.model.emission[wb.PUBLISHED.emission_actions.index("no_signal"), :, help_column]}
        wb.observation_curves(curve, {}, [f"s{i}" for i in range(k)], measure="cooperates", limits=(0, 1), ax=ax)
    wb.show(axes[0], real.card.kind, "Probability to cooperate by latent state, for 2, 3 and 4 states.")

# %%
if real is not None:
    fit = people.fits[3]
    left, right = wb.panels(4.0, 4.0, height=2.6)
    for ax, action in ((left, "no_help"), (right, "help")):
        index = wb.PUBLISHED.action(action)
        evidence = wb.RowEvidence(False, False, fit.transition_count[index].sum(axis=-1), wb.WEAK)
        wb.transition_table(fit.model.transition[index], fit.model.state_names, action, evidence, ax=ax)
    wb.show(
        left,
        real.card.kind,
        "3 states: moves after the partner defected (left) and after the partner cooperated (right).",
    )

# %%
if real is not None:
    for sentence in people.identifications[3].sentences():
        print("-", sentence)

# %% [markdown]
# **How to read it.** The states come out far apart: one that nearly always cooperates, one that nearly never does, and
# one or two between. With 3 states, a partner's defection moves the top state down by one step in some four of ten cases
# and cooperation brings the middle state up in some seven of ten; the bottom state stays where it is whatever the partner
# does. All final climbs meet at one top, so here the search is no worry. **What not to conclude:** that a partner's
# cooperation *causes* the move. Partners were not randomised: they answered to what the person had done. And the pin
# decided, before any datum, that a person's own choice leaves their state alone.
#
# ## What to take along
#
# | trap | how to notice |
# |---|---|
# | many optima | the histogram of where restarts ended; the gap to the second best |
# | slow convergence | `converged`, and the trace |
# | "highest at 4 states" | at its maximum it cannot fall with more states; look at BIC and at people held out |
# | boundary | entries at 0 or 1; missing standard errors |
# | labels | the order by response against the order by dwell time |
# | identification | the rank, strict alternation, and which table was pinned |
#
# ## What not to conclude
#
# - That a table is known because a search found it. The best optimum is the best that was found, an entry at 0 is no
#   impossibility, and what the design cannot tell no search can.
# - That the number of states is a fact about people. It is how fine a picture these data carry, and log-likelihood alone
#   always asks for one state more.
# - That the paper's search failed. Its data are not here; what is shown is what *can* happen on data like these.
#
# Next: [how sure are we?](04_how_sure_are_we.ipynb) puts a distribution in the place of one set of tables.
