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
# # How sure are we?
#
# **The question.** Baum-Welch gives one set of tables ([notebook 03](03_baum_welch_and_its_traps.ipynb)). How different
# could the tables be, given the same data? And which *conclusions* depend on what is not known?
#
# **The data.** The *simulated* study of the workbench (540 simulated people, known truth); at the end the *real* people of
# Fudenberg, Rand and Dreber (2012).
#
# **The model.** The same likelihood as there, with a prior on every row of every table:
#
# $$T(\cdot \mid s, a) \sim \text{Dirichlet}(1 + \kappa\, e_s), \qquad b_0 \sim \text{Dirichlet}(1), \qquad
# O(\text{help} \mid s, a) \sim \text{Beta}(1, 1).$$
#
# $\kappa = 2$ says that states tend to last, a little. The posterior is prior times likelihood: a distribution over tables.

# %% tags=["parameters"]
FAST = False
SEED = 1

# %%
from dataclasses import replace

import numpy as np
import pandas as pd
import pymc as pm

import analysis.workbench as wb

# %%
data = wb.load("simulated_study1")
log, digest = data.log, wb.log_digest(data.log)
sampler = wb.NutsSettings(200, 200, 2, SEED) if FAST else wb.NutsSettings(1000, 1000, 4, SEED)
log

# %% [markdown]
# ## The model in PyMC, and one prior changed by hand
#
# `build_model` returns a plain PyMC model with the latent states summed out; the likelihood is one Op around the compiled
# kernel, with its exact gradient. Everything about it can be read and changed.

# %%
model = wb.build_model(log, 2)
for variable in model.free_RVs:
    print(variable.name, variable.owner.op.__class__.__name__, model.named_vars_to_dims[variable.name])

# %% [markdown]
# Suppose somebody is convinced that hardly anybody refuses after a signal. Take the model, and add to its prior: a
# pseudo-study of 18 helping and 2 refusing in every state, under `signal` only.

# %%
with model:
    chance = model["help_probability"][wb.PUBLISHED.emission_actions.index("signal")]
    pm.Potential("conviction", pm.logp(pm.Beta.dist(19, 3), chance).sum())
    point = model.initial_point(SEED)
    print("log density at one point, with the conviction:", round(float(model.compile_logp()(point)), 2))
print("without it:", round(float(wb.build_model(log, 2).compile_logp()(point)), 2))

# %% [markdown]
# The edited prior still treats all states alike, so its draws may be put into canonical order; `fit_model` samples the
# model, sees to the order and the gate, and measures contraction against the edited prior. One that *tells states apart*
# (another term for s0 than for s1) is refused there: its labels are the prior's own.

# %%
edited_fit = wb.fit_model(model, log, 2, sampler=replace(sampler, chains=2))
print(edited_fit.gate.sentence)

# %% [markdown]
# For the many fits below the workbench has a *direct* engine: the same density, to nine digits, without PyTensor's
# compile time.
#
# ## Fit, and look at the gate before anything else

# %%
fits = {k: wb.stored_fit(log, digest, k, sampler=sampler).posterior for k in (2, 3, 4)}
for k, fit in fits.items():
    print(f"{k} states: {fit.gate.sentence}")

# %%
plain = fits[2].table("emission")
pd.DataFrame(
    {
        name: table[..., 1, :, 1].reshape(-1, 2).mean(0)
        for name, table in (("as it was", plain), ("edited", edited_fit.table("emission")))
    },
    index=["help rate after a signal, s0", "s1"],
).round(3)

# %% [markdown]
# **How to read it.** The conviction of 20 invented responses a state pulls the help rate of s0 up; s1, of which the data
# say more and which agrees with it, stays. **What not to conclude:** that a strong prior is a fault. It is a premise, and
# here it can be read.

# %%
axes = wb.panels(3.0, 3.0, 3.0, height=2.5)
for ax, (k, fit) in zip(axes, fits.items(), strict=True):
    entry = f"transition[help,s0,s{k - 1}]"
    wb.chain_ranks(fit.flat()[:, :, fit.entry_names.index(entry)], title=f"{k} states: {entry}", ax=ax)
wb.show(axes[0], "simulated", "Ranks of each chain's draws among all draws; flat means that the chains agree.")

# %% [markdown]
# **How to read it.** No divergences, r-hat below 1.01 and more than 400 effective draws of *every* entry and of
# label-invariant quantities: only then are the numbers shown without a banner. **What not to conclude:** a passed gate
# says that the sampler found *this* posterior, not that the model is right.
#
# ### Label switching
#
# Permuting the states changes neither likelihood nor prior, so the posterior has $K!$ identical copies and a chain may
# visit several. Means of raw draws would average over labels. The workbench leaves the labels free while sampling and
# sorts every draw by expected response afterwards. That is exact while the prior treats states alike, and it is better
# than forbidding the copies: a sampler that must keep $q_0 < q_1 < \ldots$ gets caught where two states nearly coincide.
# The price: the sorting key is an order statistic, *also where there is nothing to find*. In the prior itself, s0 and s3
# are far apart:

# %%
for group in ("prior", "posterior"):
    helps = fits[4].table("emission", group)[..., wb.PUBLISHED.response_names.index("help")]
    weights = fits[4].emission_weights / fits[4].emission_weights.sum()
    print(f"{group}: mean help rate of the sorted states", np.round((helps * weights[:, None]).sum(1).mean(0), 2))

# %% [markdown]
# ## Contraction: have the data said anything?
#
# $1 - \mathrm{var}(\text{posterior}) / \mathrm{var}(\text{prior})$ for every entry; the prior is sorted the same way.

# %%
axes = wb.panels(4.2, 4.2, 4.2, height=3.2)
for ax, (k, fit) in zip(axes, fits.items(), strict=True):
    found = wb.contraction(fit)
    wb.contraction_dots(found.table, known=wb.KNOWN, partly=wb.PARTLY, title=f"{k} states", ax=ax)
    print(found.sentence)
wb.show(axes[0], "simulated", "One dot an entry, the bar its table's median. Grey: the prior; green: the data.")

# %% [markdown]
# **How to read it.** With 2 states 540 people determine the tables. With the paper's 4 the transition tables *are mostly
# the prior*: whoever quotes $T(s' \mid s, a)$ from such a fit quotes an assumption. **What not to conclude:** that there are
# two kinds of people. The truth behind these simulated data has four; the design cannot show them.
#
# ## What one action changes
#
# Instead of single entries: by how much does one act of help change the expected help rate of the next round?

# %%
axes = wb.panels(4.6, 4.6, height=3.2)
for ax, k in zip(axes, (2, 4), strict=True):
    found = wb.contrasts(fits[k])
    rows = found.table[found.table["action"] == "help"]
    wb.contrast_by_state(rows, scale=found.scale, unit=found.unit, title=f"{k} states", limits=(-20, 50), ax=ax)
    print(f"{k} states: {found.sentence_of('help')}")
wb.show(
    axes[0], "simulated", "One act of help instead of none, by state before. Grey the prior, blue the posterior."
)

# %% [markdown]
# **How to read it.** State by state the 4-state model hardly knows more than its prior, except at the bottom. Averaged
# over people it knows about as much as the 2-state model. Averages can be known when their parts are not.
#
# ## The causal question
#
# Keep everybody's schedule, let the robot *always* or *never* help, and compute the expected help rate of each round
# exactly, in every posterior draw (standardisation). Since conditions were assigned at random in this design, the raw
# difference of the arms answers the same question without a model.

# %%
effects = {k: wb.causal_effects(fit, log, kind=data.card.kind) for k, fit in fits.items()}
axes = wb.panels(4.4, 4.4, height=3.3)
for ax, action in zip(axes, ("help", "signal"), strict=True):
    found = effects[4]
    wb.effect_by_round(
        found.of(action), scale=found.scale, unit=found.unit, title=action, limits=(-15, 35), ax=ax,
    )  # fmt: skip
wb.show(axes[0], "simulated", "Always against never, by round, 4 states, beside the raw difference of the arms.")

# %%
names, figures = ["mean", "low", "high"], {}
raw = ["raw", "raw_low", "raw_high"]
for k, found in effects.items():
    for action in found.actions:
        row = 100 * found.of(action).iloc[-1][names + raw].astype(float)
        figures[action, f"{k} states"] = row[names]
        figures[action, "none: raw arms"] = row[raw].set_axis(names)
pd.DataFrame(figures).T.rename_axis(["action", "states"]).sort_index().round(1)

# %% [markdown]
# And the truth, which only simulated data have: the same contrast under the tables that the data were drawn from.

# %%
truth = wb.ModelDraws.from_models([wb.calibrated_truth()])
choices = (("human_needs_help", "no_help", "help"), ("robot_needs_help", "no_signal", "signal"))
for mode, null, act in choices:
    (never, runs), (always, _) = (
        wb.expected_responses(truth, log, wb.with_action(log, mode, a)) for a in (null, act)
    )
    print(
        f"true effect of always '{act}': {100 * ((always - never)[0] @ runs / runs.sum()):+.1f} percentage points"
    )

# %% [markdown]
# **How to read it.** Three things at once. The effect over all responses is nearly the same at 2, 3 and 4 states,
# although at 4 the tables it is made of are mostly prior: the answer does not hang on the number of states. Its intervals
# are narrower than the raw ones, since the model borrows strength over rounds and schedules. *And of helping they leave
# out the truth*, which the raw interval contains. The prior is why: priors that look flat entry by entry give `help` and
# `no help` tables that are alike on average, so before any data the model all but excluded an effect of this size,

# %%
for k, found in effects.items():
    row = found.of("help").iloc[-1]
    print(f"{k} states, before any data: {100 * row['prior_low']:+.1f} to {100 * row['prior_high']:+.1f}")
print(effects[4].sentence_of("help"))

# %% [markdown]
# and 540 people only pull it part of the way. Where arms were randomised, quote the raw difference first; the model's
# contrast is for questions that the arms cannot answer. Before the first chance to help the model's effect is exactly
# zero; the raw difference in round 0 is chance, and shows how large chance is. **What not to conclude:** that a narrow
# interval is a good one; anything about people from simulated data; or, from an intention-to-treat contrast, what one
# act of help does to one person.
#
# ## Does it depend on $\kappa$?

# %%
few = wb.NutsSettings(200, 200, 2, SEED) if FAST else sampler
sensitivity = wb.kappa_sensitivity(wb.refits(log, digest, 4, sampler=few), log)
print(sensitivity.sentence)
sensitivity.table.drop(columns="positive").round(1).set_index(["quantity", "kappa"])

# %%
before = wb.prior_predictive(log, 4, draws=100 if FAST else 400, seed=SEED)
print(wb.prior_sentence(before))

# %% [markdown]
# **How to read it.** Before the data (last two columns) $\kappa$ matters for one act: the stickier, the less an action
# can do. After the data it matters little for the average effects. (Where the gate failed the sentence says so; such a
# row is rough.) But agreement over $\kappa$ is no proof of innocence: all three priors pull the effect of helping towards
# zero, as the last section showed. Also, four independent uniform help rates average out near one half, so the "flat"
# prior is surprised by a study in which four of five help. **What not to conclude:** that flat priors on entries are flat
# on what one cares about.
#
# ## Checks that the model could fail
#
# Draw a model from the posterior, draw a study from it (same design, new people), compare statistics that the fit did not
# aim at.

# %%
checks = {k: wb.posterior_checks(fits[k], log, draws=100 if FAST else 400, seed=SEED) for k in (2, 4)}
wb.show(
    wb.predictive_checks(checks[2].table, title="2 states"),
    "simulated",
    "Observed values (diamonds, filled where outside) among simulated studies (bars: 90%).",
)
for k, found in checks.items():
    print(f"{k} states: {found.sentence}")

# %% [markdown]
# **How to read it.** Both pass, as they should: these data *were* drawn from such a model. **What not to conclude:** that
# checks are a formality. Here is the same on people:
#
# ## Real people
#
# Condition `bc4_e8` of Fudenberg, Rand and Dreber: 90 people, four games each, $T(\text{no signal})$ held at the identity
# as in [notebook 03](03_baum_welch_and_its_traps.ipynb).

# %%
try:
    real = wb.load("frd2012")
except wb.InputError as failure:
    real = None
    print(f"{wb.ABSENT}: the cells on frd2012 are skipped. {failure}")

# %%
if real is not None:
    part = real.log.select(conditions=[real.card.defaults["condition"]])
    people = wb.stored_fit(
        part, wb.log_digest(part), 3 if not FAST else 2, pins={"no_signal": None}, sampler=sampler
    )
    print(people.posterior.gate.sentence)
    print(wb.contraction(people.posterior).sentence)
    print(wb.causal_effects(people.posterior, part, kind=real.card.kind).sentence_of("help"))

# %%
if real is not None:
    failed = wb.posterior_checks(people.posterior, part, draws=100 if FAST else 400, seed=SEED)
    wb.show(
        wb.predictive_checks(failed.table), real.card.kind, "Observed values among studies simulated from the fit."
    )
    print(failed.sentence)

# %% [markdown]
# **How to read it.** Here the tables are well determined, and the model is *wrong*: every game starts from the same
# initial belief, so simulated people are all alike in the long run. Real people differ, and stay different from game to
# game: the variance of their counts is several times what the model can produce, and far more of them never cooperate.
# Small intervals around the tables of a model that fails are no comfort. And the large contrast of the partner's
# cooperation is *not* an effect: partners were not randomised, they answered to what the person had done. **What not to
# conclude:** that latent states are refuted. One assumption of this model is, that everybody starts alike.
#
# ## People who differ
#
# The remedy is to let them differ: each person $i$ has an offset $\sigma z_i$, $z_i \sim N(0, 1)$, on the log-odds of
# helping, the same in all their games, and it is integrated out inside the likelihood,
#
# $$p(y_i) = \int \prod_{\text{games } g} p(y_{ig} \mid z)\, N(z; 0, 1)\, dz .$$
#
# With one state nothing else is left: a random-intercept logistic model. First the bundled study, then real people.

# %%
offset = wb.PersonOffset()


def learn(k, who):
    return wb.stored_fit(log, digest, k, people=who, sampler=sampler).posterior


found = wb.people_study(log, (1,) if FAST else (1, 2), learn, draws=100 if FAST else 400, seed=SEED)
print(found.sentence, *found.warnings, sep="\n")
print(wb.spread_sentence(found.pairs[-1].hierarchical))

# %% [markdown]
# **How to read it.** Against one state, people who differ win easily; beside a second state they add nothing to
# prediction. These simulated people have *no* offsets, and still $\sigma$ lies higher than its prior and no narrower: with
# three responses a person a state that hardly moves passes for a trait. **What not to conclude:** that people differ, or
# that they do not. The data cannot say.

# %%
if real is not None and not FAST:
    wide = wb.PersonOffset(scale=4.0, nodes=61)
    settled = wb.stored_fit(
        part, wb.log_digest(part), 1, pins={"no_signal": None}, people=wide, sampler=sampler
    ).posterior
    print(settled.gate.sentence, wb.spread_sentence(settled), sep="\n")
    differ = wb.posterior_checks(settled, part, draws=400, seed=SEED)
    wb.show(wb.predictive_checks(differ.table), real.card.kind, "The same checks, people differing and one state.")
    print(differ.sentence)

# %% [markdown]
# **How to read it.** With some thirty responses a person $\sigma$ is well determined, and now the differences between
# people (how much their counts vary, who always or never cooperates) look as they should, with a single state. What it
# cannot do is change: first and last responses, and runs of equal ones, are for the states to explain. Both together
# (`prosocial bayes frd2012 --states 2 --people-differ --person-scale 4 --person-nodes 61`) is a few minutes of work.
# **What not to conclude:** that people are of fixed kinds, because a model without change gets their differences right.
#
# ## What to take along
#
# | question | where the answer stands |
# |---|---|
# | may I believe the sampler? | the gate; no number without it |
# | may I quote this entry? | its contraction |
# | may I quote this effect? | the contrast, its kappa table, and the raw arms where there are any |
# | is the model good enough? | checks it could fail, conditioned on what they say |
# | is it causal? | only where the design assigned the action |
#
# ## What not to conclude
#
# - That a passed gate makes a model right, or that a narrow interval makes an answer right. The intervals of helping left out
#   the truth that the study was drawn from, because the prior did.
# - That tables with contraction near zero say anything about people. They repeat the prior.
# - Anything about people from the simulated study, or about effects from the real one.
#
# Next: [the mixed model and the tests of both studies](05_the_mixed_model.ipynb), which knows no states at all.
