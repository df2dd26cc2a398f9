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
# # The mixed model and the tests of both studies
#
# **The question.** Notebooks [03](03_baum_welch_and_its_traps.ipynb) and [04](04_how_sure_are_we.ipynb) learn hidden
# states. The paper also tests study 1 with a regression and study 2 with analyses of variance, which know none. What do
# these tests say, what do they not say, and how much hangs on the way they are computed?
#
# **The data.** The *simulated* study 1 of the workbench; the *real* people of Fudenberg, Rand and Dreber (2012) where a
# model should be seen failing; small studies simulated on the spot.
#
# **The model.** Person $i$ responds in round $j$; everybody has an intercept of their own that never changes:
#
# $$\operatorname{logit} P(y_{ij} = 1 \mid u_i) = \beta_0 + \beta_1\,\text{signal}_{ij} + \beta_2\,\text{robot help}_i
# + \sigma u_i, \qquad u_i \sim N(0, 1).$$
#
# `signal` is the robot's action in the round; `robot_help` is what the condition's robot does throughout, so it says 1
# also for responses before its first chance to help. The likelihood of a person is an integral over $u_i$ that has no
# closed form. How it is approximated is most of this notebook.

# %% tags=["parameters"]
FAST = False
SEED = 1

# %%
import numpy as np
import pandas as pd

import analysis.workbench as wb

# %% [markdown]
# ## The regression of study 1

# %%
data = wb.load("simulated_study1")
study = wb.regress(data.log)
print(study.main.summary())

# %% [markdown]
# **How to read it.** Coefficients are log odds ratios *for one and the same person*. The last row is the spread between
# people on the same scale, and it is large: most people always help or never do (the row "groups that never vary"). A
# Wald test of it would mean nothing, so there is none. **What not to conclude:** anything about people: these are
# simulated.

# %%
study.models.drop(columns="BIC").round(2)

# %%
study.tests.round(4)

# %% [markdown]
# The paper tests help "compared to the null model". There are two ways to do that, alone or beside the signal; both rows
# are here. And of the interaction:

# %%
print(wb.interaction_sentence(study))

# %% [markdown]
# ## Odds are not likelihood
#
# The paper reads its odds ratio of 10.42 as "10.42 times more likely". Two things are wrong with that. An odds ratio is
# about odds. And in a mixed model it is about one person, not about people: averaged over $u$, odds ratios shrink,
#
# $$P(x) = \int \operatorname{expit}(x'\beta + \sigma u)\,\varphi(u)\,du .$$

# %%
for term in study.terms:
    print(wb.odds_sentence(study, term))

# %%
grid = np.linspace(0, 5, 60)


def over_people(intercept, sd):
    low, high = (wb.mean_probability(np.array([eta]), sd)[0] for eta in (intercept, intercept + np.log(10.42)))
    return high / (1 - high) * (1 - low) / low


lines = {f"intercept {b:g}": (grid, [over_people(b, sd) for sd in grid]) for b in (0.0, 1.5, 3.0)}
ax = wb.curves(lines, xlabel="standard deviation of people's intercepts", ylabel="odds ratio over people")
wb.show(ax, "definition", "What an odds ratio of 10.42 for one person is over people, by how much people differ.")

# %% [markdown]
# **How to read it.** Where nobody differs ($\sigma = 0$) the two are the same. At a spread of 2 or 3, an odds ratio of ten
# for each person is one of three to six over people. **What not to conclude:** that one of them is wrong. They answer
# different questions; a paper has to say which one it asks. "Times as likely" is a third number, the smallest of all
# where most people help anyway.
#
# ## Laplace's approximation near the ceiling
#
# The customary tool approximates each person's integral at one point, its mode. With three responses a person, most of
# whom always help, that is not good enough. The same data under more and more nodes of adaptive Gauss-Hermite quadrature:

# %%
wb.node_table(study.main).round(3)

# %%
laplace = wb.regress(data.log, "laplace")
print(wb.rules_sentence(study, laplace))
for note in laplace.main.notes:
    print(f"{note.category.__name__}: {note.text}")

# %% [markdown]
# One node makes people differ far more than finer rules, which settle. Log-likelihoods must not be compared between rows:
# Laplace's is higher because it is wrong, not because it fits better. Is that this data set, or is it the method? Draw
# studies from known truths with a rising share of people who always help:

# %%
ceiling = wb.quadrature_study((0.0, 1.0, 2.0, 2.5, 3.0, 3.5), replicates=20 if FAST else 200, seed=SEED)
axes, ratio = wb.panels(4.4, 4.4, height=3.1), float(np.exp(ceiling.effect))
words = [f"estimated {what}" for what in ("standard deviation", "odds ratio")]
wb.rules_near_ceiling(ceiling.summary, "sd", truth=ceiling.sd, ylabel=words[0], ax=axes[0])
wb.rules_near_ceiling(ceiling.summary, "odds_ratio", truth=ratio, ylabel=words[1], legend=False, ax=axes[1])
wb.show(
    axes[0], "simulated",
    f"{ceiling.people} people with {ceiling.responses} responses each, both fits of every study. Median; bars hold half "
    "of the studies.",
)  # fmt: skip
print(ceiling.sentence)

# %% [markdown]
# **How to read it.** Up to some 70% of people at the ceiling Laplace is a little off in either direction; beyond, it runs
# away to spreads that are not in the data. Quadrature stays on the truth. The odds ratio suffers less than the spread.
# **What not to conclude:** that Laplace is useless. With thirty responses a person it is fine (see the real people below).
# That is why the workbench prints, with every fit, what twice the nodes would change.
#
# ## Do intervals keep their word?
#
# An interval of 95% should hold the truth in 95 of 100 studies. Five hundred studies were drawn from the mixed model itself
# under the published design, at two rates of help, each fitted by both rules, with a profile and a Wald interval of every
# parameter. That is stored evidence (`prosocial coverage` makes it anew):

# %%
stored = wb.read_evidence("mixed_model")
print(stored.provenance)
found = pd.DataFrame(stored.content["table"])
axes = wb.panels(4.4, 4.4, height=3.4)
for ax, rate in zip(axes, stored.content["rates"], strict=True):
    own, title = found[found["intercept"] == rate["intercept"]], f"{rate['rate']:.0%} of responses are helping"
    wb.coverage_by_parameter(own, 0.95, title=title, legend=ax is axes[-1], ax=ax)
wb.show(
    axes[0], "simulated", "Share of 500 studies whose interval holds the truth; the band is where exact intervals lie.",
)  # fmt: skip
print(stored.sentence)

# %%
found.pivot_table(index=["intercept", "parameter"], columns=["rule", "interval"], values="share", sort=False).round(
    3
)

# %% [markdown]
# **How to read it.** By quadrature every interval of both kinds stays in the band. By Laplace the intervals of the spread
# and of the intercept miss the truth far too often, and near the ceiling those of the odds ratios hold it always: they
# are nearly twice as wide as they should be, because the spread is. **What not to conclude:** that a Wald interval is as
# good as a profile one. Near the ceiling it misses to one side: see `below` and `above` in the evidence.
#
# ## Profile intervals
#
# A Wald interval assumes that the log-likelihood is a parabola. A profile interval asks which values a likelihood-ratio
# test does not reject, and may be lopsided.

# %%
ends = {kind: np.asarray(study.main.conf_int(method=kind)) for kind in ("wald", "profile")}
pd.DataFrame(
    {
        "estimate": study.main.params,
        **{f"{kind} {side}": ends[kind][:, i] for kind in ends for i, side in enumerate(("from", "to"))},
    }
).round(3)

# %% [markdown]
# With 540 people the two nearly agree. Take fewer:

# %%
frame = study.table.frame
few = frame[frame["participant"] <= 60]
small = wb.LogisticMixedModel.from_formula(study.table.formula(study.table.main), few).fit(warn=False)
rows = {}
for kind in ("wald", "profile"):
    low, high = np.asarray(small.conf_int(method=kind)).T
    rows[f"{kind} from"], rows[f"{kind} to"] = low, high
pd.DataFrame({"estimate": small.params, **rows}).round(2)

# %% [markdown]
# **How to read it.** The upper ends move most: large odds ratios and spreads are hard to exclude near the ceiling, and a
# symmetric interval hides that. **What not to conclude:** that profile intervals mend Laplace. They are exact for the
# likelihood they are given.
#
# ## What else a fit knows
#
# Everybody's intercept with an interval, and how much the fit hangs on each person. At the command line,
# `prosocial glmm simulated_study1 --groups people.csv` writes this table.

# %%
table = wb.group_table(study.main)
table.drop_duplicates("successes").sort_values("successes")[
    ["successes", "mode", "mean", "sd", "lower", "upper", "cook"]
].round(3)

# %%
print(wb.influence_of(study.main)["text"])

# %% [markdown]
# **How to read it.** One person for each number of helping responses. Whoever helped three times of three has an interval
# that reaches far up: there is no saying how high. Leaving out anybody moves no estimate by more than a fraction of its
# standard error; the few who never helped although their robot did move it most.
#
# Where a group of people always responds alike, the fit says so by name instead of printing a large number with a small
# star. Here the sixty people again, those with a helping robot made to help always:

# %%
always = few.assign(help=np.where(few["robot_help"] == 1, 1, few["help"]))
for note in (
    wb.LogisticMixedModel.from_formula("help ~ signal + robot_help + (1|participant)", always).fit(warn=False).notes
):
    print(f"{note.category.__name__}: {note.text}")

# %% [markdown]
# ## Beside the printed numbers
#
# The people here are simulated and are not the paper's; the column of printed numbers is for orientation.

# %%
sources = [wb.of_print(wb.published()), wb.of_fit(wb.LAPLACE, laplace), wb.of_fit(wb.QUADRATURE, study)]
wb.side_by_side(sources, study).set_index("quantity")

# %%
ax = wb.odds_forest(wb.long_form(sources[1:]), sources=[wb.LAPLACE, wb.QUADRATURE])
wb.show(ax, "simulated", "Odds ratios for one person with 95% Wald intervals under both rules.")
for text in wb.consistency(wb.published()):
    print(text)
print("\nThe paper:", wb.READING)

# %% [markdown]
# **How to read it.** The printed interval and the printed z belong to slightly different standard errors, and the printed
# $\chi^2$ and $\Delta$AIC to different comparisons. Neither changes a conclusion. **What not to conclude:** that agreement
# with the simulated study confirms anything; its truth was chosen to land near these numbers.
#
# ## Does the regression describe the data?

# %%
checked = wb.residuals(study, data.log, SEED)
axes = wb.panels(4.6, 4.6, height=3.4)
wb.rates_beside(wb.by_condition(study, data.log), measure="help rate", ax=axes[0])
wb.residual_classes(checked.by, limit=checked.limit, ax=axes[1])
wb.show(
    axes[0], "simulated", "Rates by condition beside the model's; mean residuals by round, condition and schedule."
)
print(checked.sentence)

# %% [markdown]
# **How to read it.** Residuals are randomised quantile residuals given a person's *earlier* responses: uniform and
# independent if the model is right. They pass, although these data were drawn from a model with moving states. **What not
# to conclude:** that people do not change; three responses a person cannot tell a trait from a state (it was the same in
# [notebook 04](04_how_sure_are_we.ipynb)). Thirty can, as real people show:

# %%
try:
    real = wb.load("frd2012")
except wb.InputError as failure:
    real = None
    print(f"{wb.ABSENT}: the cells on frd2012 are skipped. {failure}")

# %%
if real is not None:
    part = real.log.select(conditions=[real.card.defaults["condition"]])
    people = wb.regress(part)
    found = wb.residuals(people, part, SEED)
    wb.show(
        wb.residual_classes(found.by, limit=found.limit), real.card.kind,
        "The same check on people: the regression misses how cooperation changes over rounds.",
    )  # fmt: skip
    print(found.sentence)
    print(wb.rules_sentence(people, wb.regress(part, "laplace")))

# %% [markdown]
# **How to read it.** First rounds lie far above what the model says, later ones below: people change, and a fixed
# intercept does not. (`help_before` is whether the partner has cooperated before; partners answer to people, so its odds
# ratio is no effect.) **What not to conclude:** that a regression that passes its checks is right; it may only have been
# asked too little.
#
# ## Other readings of the formula

# %%
other = wb.readings(study, 25)
for term in study.terms:
    print(other.sentence_of(term))

# %% [markdown]
# ## Does signalling work differently in different states?
#
# Of signalling the paper says:

# %%
print(wb.STATE_CLAIM)

# %% [markdown]
# That can be tested, not only said. A hidden Markov model gives the effect of a signal *by state*: on the response in the
# same round, $O(\text{help} \mid s, \text{signal}) - O(\text{help} \mid s, \text{no signal})$, and through the state on the
# next. The regression has one number for everybody.

# %%
sampler = wb.NutsSettings(200, 200, 2, SEED) if FAST else wb.NutsSettings(1000, 1000, 4, SEED)
digest = wb.log_digest(data.log)
fits = {k: wb.stored_fit(data.log, digest, k, sampler=sampler).posterior for k in (2, 4)}
effects = {k: wb.signal_by_state(fit, "signal", study.marginal["signal"]) for k, fit in fits.items()}

# %%
axes, table = wb.panels(4.4, 4.4, height=3.2), effects[4].table
look = {"regression": effects[4].regression.difference, "limits": (-45, 45)}
for ax, quantity in zip(axes, (wb.SAME, wb.NEXT), strict=True):
    rows = table[table["quantity"] == quantity]
    wb.signal_effects(rows, title=f"response in the {quantity}", legend=quantity == wb.SAME, ax=ax, **look)
wb.show(
    axes[0], "simulated", "Effect of a signal by state at 4 states (90%), and the regression's one number (95%)."
)
for found in effects.values():
    print(found.sentence)

# %% [markdown]
# **How to read it.** Intervals at the lower states are several times as wide as the regression's, and the difference
# between the highest and the lowest state covers every story one would like to tell. The latent-state model *allows* the
# effect to depend on the state; that is not evidence that it does. **What not to conclude:** that there is no difference.
#
# ## Study 2: analysis of variance, Tukey, Dunnett
#
# What is printed of study 2 can be held against itself: with 100 people under five policies, p and effect sizes follow from
# the printed F.

# %%
printed = wb.printed_anova(wb.published())
print(wb.anova_consistency(printed))
printed.drop(columns="agrees").round(4)

# %% [markdown]
# Study 2's people are not part of this project, and its game is played in [notebook 08](08_the_token_game.ipynb). So the
# numbers below are made up on the spot, in study 2's design: five policies, before and after, 100 people. People differ,
# everybody improves, and two policies are better than the rest.

# %%
rng, n = np.random.default_rng(SEED), 100
policies = np.repeat(["ls-POMDP", "always", "never", "myopic", "reactive"], n // 5)
first = rng.normal(60, 8, n)
gain = 6 + 8 * np.isin(policies, ["ls-POMDP", "always"])
times = {"first": first + rng.normal(0, 5, n), "last": first + gain + rng.normal(0, 5, n)}
rows = pd.DataFrame({"id": np.arange(n), "policy": policies, **times})
rows = rows.melt(["id", "policy"], var_name="time", value_name="performance")

# %%
names = {"between": "policy", "within": "time", "subject": "id", "times": ("first", "last")}
measures = wb.RepeatedMeasures.from_frame(rows, dv="performance", **names)
tested, people = wb.mixed_anova(measures), wb.PersonValues.at(measures)
print(tested.sentence)
wb.show(
    wb.cell_means(tested.cells, xlabel="time", ylabel="performance (made up)"), "simulated",
    "Means with 95% intervals. Two policies rise more than the others: an interaction.",
)  # fmt: skip

# %%
pairs, versus = wb.tukey(people), wb.dunnett(people, "ls-POMDP")
axes = wb.panels(4.4, 4.4, height=3.4)
wb.compared_groups(pairs, xlabel="performance", ax=axes[0])
wb.compared_groups(versus, xlabel="performance", ax=axes[1])
wb.show(axes[0], "simulated", "All ten pairs by Tukey; the four comparisons with ls-POMDP by Dunnett.")
print(pairs.sentence)
print(versus.sentence)

# %% [markdown]
# **How to read it.** A policy that works shows as an *interaction*: before it acts, there is nothing to differ. The paper
# compares four policies with one, its own, and prints Tukey's comparisons of all ten pairs; Dunnett's test is made for
# comparing with one reference and loses less: compare the lengths of the intervals. What is fed matters: one value a person,
# here the last. **What not to conclude:** anything about the paper's policies. Which are better was put in.
#
# Whether somebody helped is 0 or 1. An analysis of variance ignores that its variance depends on its mean; the mixed model
# of this notebook, with `policy * time`, is the test that fits. It comes in the same two types, and unlike there the type
# matters for log-odds even where groups are of one size:

# %%
chance = 1 / (1 + np.exp(-(0.5 + 0.25 * (rows["performance"] - 65))))
helped = rows.assign(help=(rng.random(len(rows)) < chance).astype(int))
twin = wb.RepeatedMeasures.from_frame(helped, dv="help", **names)
print(wb.mixed_anova(twin).sentence)
for ss_type in (3, 2):
    beside = wb.logistic_twin(twin, ss_type)
    print(f"\n{beside.title}, sd {beside.sd:.2f}:")
    print(beside.table.round(4).to_string(index=False))
    print(*beside.notes, sep="\n")

# %% [markdown]
# ## Power
#
# The paper prints f = .25, $\alpha$ = .05, power .95 and the numbers of people 200 and 90. Which test they belong to is not
# printed, and neither is the correlation between two measurements of a person, on which the number hangs:

# %%
sizes = wb.printed_sizes()
print(sizes.sentence)

# %%
axes = wb.panels(5.0, 5.0, height=4.4)
for ax, (name, part) in zip(axes, sizes.curves().groupby("study", sort=False), strict=True):
    own = sizes.table[sizes.table["study"] == name]
    wb.power_by_people(
        {test: rows.rename(columns={"power": "value"}) for test, rows in part.groupby("test", sort=False)}, 0.95,
        reached=dict(zip(own["test"], own["n"], strict=True)), printed=own["printed"].iloc[0], title=name, ax=ax,
    )  # fmt: skip
wb.show(
    axes[0],
    "definition",
    "Power of the tests each study could have meant, f = .25; the star is the printed number.",
)

# %% [markdown]
# One number of people for one test is not an answer, for nobody knows the correlation $\rho$ beforehand. The same
# interaction of five policies and two times:

# %%
designs = [wb.FTestDesign("interaction", 5, times=2, rho=rho) for rho in (0.2, 0.43, 0.6, 0.8)]
lines = {
    f"rho = {d.rho:g}": pd.DataFrame({"people": (at := wb.curve_people(d, 110)), "value": wb.power_curve(d, at)})
    for d in designs
}
needed = {f"rho = {d.rho:g}": float(wb.sample_size(d)) for d in designs}
ax = wb.power_by_people(lines, 0.95, reached=needed, printed=90)
wb.show(
    ax,
    "definition",
    "Interaction 5 x 2 at four correlations. The printed 90 people are what the formula asks for at rho = .43.",
)

# %% [markdown]
# **How to read it.** Between a correlation of .2 and one of .8 lies a factor of four in people. **What not to conclude:**
# that the paper assumed .43: nothing printed says so.
#
# ### The mixed model, by simulation
#
# Formulas of F tests know neither a bounded outcome nor two or three responses a person. So studies are drawn from the
# mixed model under study 1's design, with the printed odds ratios and an intercept and spread that are not printed and
# were chosen, and fitted like any other.

# %%
sizes_of = {"signal": (100, 200, 400, 800, 1600), "robot_help": (20, 40, 80, 160)}
simulated = {
    term: wb.mixed_model_power(
        wb.MixedModelPower(
            wb.study1_rows(), wb.STUDY1_TRUTH, wb.STUDY1_SD, (term,), at, 40 if FAST else 300, seed=SEED
        )
    )
    for term, at in sizes_of.items()
}

# %%
axes = wb.panels(4.4, 4.4, height=3.2)
for ax, (term, found) in zip(axes, simulated.items(), strict=True):
    tests = found.table.rename(columns={"power": "value"}).groupby("test", sort=False)
    lines = {wb.TEST_NAMES[test]: part for test, part in tests}
    curves_at = {name: part[["people", "value", "low", "high"]].to_numpy().T for name, part in lines.items()}
    needed = {name: wb.reached(*at, 0.8).n for name, at in curves_at.items()}
    wb.power_by_people(
        lines, 0.8, reached=needed, title=f"{term}: odds ratio {np.exp(wb.STUDY1_TRUTH[term]):.2f}", ax=ax
    )
wb.show(axes[0], "simulated", "Share of simulated studies with p < .05, with its 95% interval; 80% wanted.")
for found in simulated.values():
    print(found.sentence(0.8))

# %%
null = wb.MixedModelPower(
    wb.study1_rows(),
    wb.STUDY1_TRUTH | {"signal": 0.0},
    wb.STUDY1_SD,
    ("signal",),
    (540,),
    100 if FAST else 1000,
    seed=SEED,
)
wb.mixed_model_power(null).table[["people", "test", "power", "low", "high"]].round(3)

# %% [markdown]
# **How to read it.** The printed effect of the robot's help needs about sixty people; that of signalling about a
# thousand, for most people are at the ceiling, where a signal has little left to change. With the 540 who took part a
# signal of that size would be found about every second time, so that p = .077 is no evidence against it. The last table
# is the size of the tests: without an effect they are significant in about 5% of studies.
#
# ### The latent-state model's own question
#
# No null hypothesis is tested with the latent-state model. Its question is: with how many people, and which sequences,
# does a transition table become *known*? Contraction, $1 -
# \operatorname{var}(\text{posterior})/\operatorname{var}(\text{prior})$, says how much of the prior doubt a study
# removes. Studies are drawn from a known truth with four states and learned from:

# %%
few_draws = wb.NutsSettings(60, 60, 2) if FAST else wb.NutsSettings(250, 250, 2)
plans = {
    "study 1": wb.study1_design(),
    "HRHRH": wb.schedules_design(["HRHRH"]),
    "study 2": wb.schedules_design([wb.published()["study2"]["sequence"]]),
}
at = (50, 100) if FAST else (100, 400, 1600, 6400)
asked = wb.ContractionPower(wb.calibrated_truth(), plans, at, 2 if FAST else 4, sampler=few_draws, seed=SEED)
known = wb.contraction_power(asked)

# %%
curve = known.table[known.table["table"] == wb.ALL_MOVES].rename(columns={"mean": "value"})
lines = dict(list(curve.groupby("design", sort=False)))
needed = {name: known.reached(0.5, wb.ALL_MOVES, name).n for name in lines}
ax = wb.power_by_people(lines, 0.5, reached=needed, ylabel="expected contraction, all moves", log_x=True)
wb.show(
    ax, "simulated", "Expected contraction of the transition tables by people and sequences, with 90% intervals."
)
print(known.sentence(0.5))

# %%
needed = pd.DataFrame({name: {t: known.reached(0.5, t, name).n for t in known.tables} for name in asked.designs})
needed.map(lambda n: f"more than {at[-1]:,}" if np.isnan(n) else f"{np.ceil(n):,.0f}").rename_axis("people needed")

# %% [markdown]
# **How to read it.** Half of the doubt about how states move takes thousands of people with study 1's five rounds. Study 2's
# nine rounds, with five responses a person instead of three, do it with less than half as many. Five rounds in strict
# alternation do least: between two responses there is always a move of the robot's signal *and* one of its help, so that
# only products of two tables enter the likelihood (trap 6 of [notebook 03](03_baum_welch_and_its_traps.ipynb)); study 2
# alternates too, but shows more of these products. How a state *responds* is known long before how it moves. **What not
# to conclude:** that tables are known once this line is crossed: it is a mean over studies and a median over entries.

# %% [markdown]
# ## What to take along
#
# | question | where the answer stands |
# |---|---|
# | may I believe the fit? | what twice the nodes change; the notes under the summary |
# | how large is it? | probabilities over people, beside the odds ratio for one |
# | how sure is it? | profile intervals near the ceiling |
# | does the model describe the data? | residuals by round, condition, schedule |
# | is it causal? | only what the design assigned |
# | may I believe the intervals? | coverage: by quadrature yes, by Laplace near the ceiling no |
# | were there enough people? | power by simulation, with its assumptions; contraction for tables |
# | does it depend on the state? | the difference between states with its interval, not the model's name |
#
# ## What not to conclude
#
# - That "10.42 times more likely" is what an odds ratio of 10.42 says, or that one number of people is what a power
#   analysis says. Both hang on a spread or a correlation that is not printed.
# - That p = .077 is evidence against an effect of signalling. It is what studies of this size find about every second time.
# - That a model without states was shown to be better or worse than one with them: they were asked different questions.
#
# Next: [plans and baselines](06_plans_and_baselines.ipynb). What should a robot do that knew how people change?
