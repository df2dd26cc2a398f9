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
# # Robust planning and the value of information
#
# **The question.** Given everything we believe about how people change, what should the robot do, how much does our doubt
# cost, and which data would reduce it?
#
# **The data.** The *simulated* study of 540 people: the posterior of its tables with four states, as in
# [notebook 04](04_how_sure_are_we.ipynb).
#
# **The model.** Draws $\theta_1, \dots, \theta_N$ of the posterior with weights $w_i$. A plan $\pi$ is worth $V_i(\pi)$ in
# draw $i$, whose own optimum is $V^*_i$. The robot may
#
# $$\text{learn which draw it faces:}\quad \max_\pi \sum_i w_i V_i(\pi), \qquad
# \text{be cautious:}\quad \max_\pi \mathrm{CVaR}_\alpha[V(\pi)], \qquad
# \text{regret little:}\quad \min_\pi \max_i\, V^*_i - V_i(\pi).$$
#
# All three are found exactly over the nine rounds of the paper's second study. Values are in reward units a person; one act
# of helping costs 15.

# %% tags=["parameters"]
FAST = False
SEED = 1

# %%
import analysis.workbench as wb

# %%
data = wb.load("simulated_study1")
sampler = wb.NutsSettings(draws=300, tune=300, chains=2, seed=SEED) if FAST else wb.NutsSettings(seed=SEED)
posterior = wb.stored_fit(data.log, wb.log_digest(data.log), 4, sampler=sampler).posterior
print(posterior.gate.sentence)
draws = posterior.draws().thin(200) if FAST else posterior.draws()
study = wb.Schedule.of(draws, wb.STUDY2)
chains = posterior.gate.chains

# %% [markdown]
# ## Every draw has its own best plan
#
# If a draw were known to be true, its best plan is a matter of [notebook 06](06_plans_and_baselines.ipynb). There are
# thousands of draws, and the walk over all histories takes them together:

# %%
own = wb.own_plans(study)
print(
    f"{draws.n_draws} draws, {len(own.plans)} different plans; the most common is best for {own.shares[0]:.0%} of them."
)
print("First action preferred:", {a: f"{s:.0%}" for a, s in own.first_action_shares.items()})

# %% [markdown]
# No plan is best for many. So ask instead for the plan that is best *on average over everything believed*. On its way the
# robot also learns which draw it faces, as far as one person's responses tell. It is the same tree of histories, over the
# joint vector of draw and state, and exact:

# %%
plan = wb.solve_schedule(study)
print(plan.sentence)
stability = wb.decision_stability(study, plan)
print(stability.sentence)
wb.show(
    wb.stability_tree(stability), "simulated",
    "Every decision of the Bayes-adaptive plan and the share of the draws that would do the same, each with its own belief "
    "about the person. Help upwards, bold frames act, lines as wide as histories are probable.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** The first decision is safe, and so are the late ones: with few rounds left, help pays for itself in
# hardly any draw. In between, whether to help after the first responses is nearly a coin toss between draws. **What not to
# conclude:** that a decision on which the draws agree is right. They share one model and one prior.
#
# Event by event: how many of the draws agree, where fewest do, what being wrong costs there, and what the responses have
# told of the draws so far (in bits; four thousand equally likely ones are twelve bits of doubt).

# %%
stability.by_event.round(3)

# %% [markdown]
# Where draws disagree, being wrong is not cheap; and one person's responses tell next to nothing of which draw is true.
#
# ## What do the usual shortcuts cost?
#
# Plans that people would use, each valued in every draw. *Held out*: chosen on one half of the draws, scored on the other.

# %%
estimate = wb.BaumWelch(4, restarts=30 if FAST else 200, seed=SEED).fit(data.log).model
prices = wb.price(study, wb.standard_candidates(study, plug_in=estimate), optima=own.values, chains=chains)
print(prices.sentence)
wb.show(
    wb.plan_comparison(prices), "simulated", "Mean over the draws, on held-out draws, in the worst tenth and in the worst draw.",
)  # fmt: skip

# %%
shown = ["mean", "held_out_mean", "cvar", "gain_mean", "gain_cvar", "gain_probability", "cvar_regret", "max_regret"]
prices.table.set_index("name")[shown].round(2)

# %% [markdown]
# **How to read it.** Averaged over the draws, the plan of the point estimate loses: it acts on tables that few draws share.
# That is about what the data leave open, not about the one truth behind these simulated people, in which that plan does
# well ([notebook 06](06_plans_and_baselines.ipynb) values it there): one good outcome does not make it the better bet. The
# tables' *means* do as well as the full tree here, since so little is learned on the way. Diamonds on dots mean that
# choosing and scoring on the same draws flattered nobody. **What not to conclude:** that the order of the plans in front
# is one: look at the gains with their probabilities, not at ranks.

# %%
shown = {
    "optimum of each draw": own.values,
    **{n: prices[n].values for n in ("Bayes-adaptive", "plug-in estimate", "always")},
}
wb.show(
    wb.value_distributions(shown, draws.weight), "simulated",
    "What is believed of each plan's value: the share of the draws in which it is worth at most so much.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Between the first curve and the second lies what doubt costs. **What not to conclude:** that a person
# may gain or lose so much. The spread is over *tables*; each point is already a mean over people.
#
# ## Caution
#
# A cautious analyst looks at the worst share $\alpha$ of the draws. The best plan may draw lots between plans. It is
# found by column generation: mix the plans found so far, let the draws in which the mixture fares worst call for a better
# one, stop when none is. Both bounds are recomputed outside the linear program.

# %%
levels = (1.0, 0.5, 0.25, 0.1, 0.05, 0.01)
flipped, flips = wb.contested(study)
print("contested costs:", {a: round(c, 3) for f in flips for a, c in f.costs.items() if c})
frontiers = {"published costs": wb.frontier(study, levels), "contested costs": wb.frontier(flipped, levels)}
for name, found in frontiers.items():
    print(f"{name}: {found.sentence} Largest gap {max(p.gap for p in found.plans):.1g}.")
for flip in wb.flip_points(study):
    print(flip.sentence)

# %%
wb.show(
    wb.caution(frontiers), "simulated",
    "What caution gains in the tail and gives up on average. Contested costs are those where the first decisions of both "
    "modes flip together.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** At contested costs there is something to decide, at the published ones hardly anything: a robot that
# seldom acts has little to be cautious about. **What not to conclude:** that caution never pays; it depends on the costs.
#
# A mixture can be read: how often which plan.

# %%
careful = wb.cautious_plan(flipped, 0.1)
print(f"worst tenth: {careful.lower:.3f}, gap {careful.gap:.1g}; mean {careful.mean:.3f}")
for plan_, share in zip(careful.plans, careful.share, strict=True):
    print(f"{share:.0%}:", " · ".join(wb.acting_words(flipped, plan_)))
single = wb.best_single(careful)
print(f"without drawing lots at most {single.lost:.2g} is lost: the best of {single.looked:,} plans looked at")

# %% [markdown]
# ## Is more data worth it?
#
# If the draw were known, the robot would gain $\mathrm{EVPI} = \sum_i w_i V^*_i - \max_\pi \sum_i w_i V_i(\pi)$, exactly:

# %%
perfect = wb.perfect_information(study, chains=chains)
print(perfect.sentence)

# %% [markdown]
# Which tables does that come from? One block at a time:

# %%
blocks = wb.partial_information(study, chains=chains, perfect=perfect)
print(blocks.sentence)
wb.show(
    wb.information_by_block(blocks), "simulated",
    "Worth of knowing one block for sure: a rule fitted on some draws and scored on the others (bars, twice the standard "
    "error), and scored on its own draws (diamonds, optimistic).",
)  # fmt: skip

# %% [markdown]
# **How to read it.** How help moves people is worth most: it is what a plan that helps would bet on. Bars do not add up,
# for blocks are known together. **What not to conclude:** that a study could deliver a block. None teaches one table
# alone.
#
# And a real study is not perfect knowledge. Data of $n$ more people reweight the draws; simulate them many times:

# %%
studies = wb.published_studies(draws.protocol, "HRHRH")
sizes = (50, 200) if FAST else (50, 100, 200, 400)
worth = wb.sample_information(study, studies, sizes, replicates=20 if FAST else 100, seed=SEED, perfect=perfect)
print(worth.sentence)
print(f"In one sentence: {stability.standings[0].words[:-1]}; {worth.best.words} would take away "
      f"{worth.best.share_of(perfect.value)} of what doubt costs.")  # fmt: skip
wb.show(
    wb.information_by_people(worth), "simulated",
    "Expected gain from more people, by condition, and with actions that vary within every person. Dashed: perfect knowledge.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Every line lies far below the dashed one: even hundreds of people more take away a minor part of what
# doubt costs. Most is learned from people who are left alone, and where actions vary within a person. **What not to
# conclude:** that data are worth no more than this. It is their worth for *this decision*, for one person served.
#
# ## Without an end
#
# The same doubt in the repeated interaction: every draw solved with its certificate. No tree of histories has an end
# there, so plans are finite-state controllers, each valued in every draw by linear systems; the draws' upper bounds say
# what no policy exceeds.

# %%
batch = wb.LatentBatch(draws.thin(60 if FAST else 400), wb.alternating(draws.protocol))
endless = wb.endless_study(batch, wb.STUDY2)
print(endless.solution.sentence)
print(endless.pool.sentence)
wb.show(
    wb.value_distribution(endless.pool), "simulated", "What the repeated interaction is worth in each draw, by plan.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** As over nine rounds, but doubt costs more: there is more time to be wrong in. Dots are means.
# **What not to conclude:** that the first curve can be had. It knows each draw.
#
# Which action do the draws prefer, over all beliefs that the robot may hold? Draws are solved from the corners of the
# simplex too, for a solution is certified where it starts, and may be poor elsewhere.

# %%
wb.show(
    wb.stability_map(endless.wide), "simulated",
    "Share of the draws that prefer to act, over beliefs about three states at a time; the dark line splits the draws in half.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** Each triangle is a face of the simplex of beliefs (as in the explorer of
# [notebook 06](06_plans_and_baselines.ipynb), there for one truth). The dark line is where the draws split. **What not to
# conclude:** that the pale corner is certain: a share of the draws is a share of *these* draws.
#
# And along the study's histories, each draw at its own belief, with the robot following the plan of the mean tables:

# %%
print(endless.along.sentence)
wb.show(
    wb.stability_along(endless.along), "simulated",
    "Share of the draws that prefer to act next. One dot a history, larger the more probable it is; lines are means.",
)  # fmt: skip

# %% [markdown]
# **How to read it.** On signalling the draws agree at every history, on helping they are divided at most.
# **What not to conclude:** that the two are equally important: what a divided decision costs is in the table above.
#
# ## Does it do better in truth?
#
# Draws are what we believe, not the truth. So: truths drawn from the prior, study 1 simulated in each, everything learned
# from it, plans valued in the truth. This takes half an hour; here is what is stored.

# %%
stored = wb.read_evidence("plans_in_truth")
print(stored.sentence if stored else "no evidence is stored: make evidence")

# %% [markdown]
# ## What to take along
#
# | question | where the answer stands |
# |---|---|
# | is this decision safe? | the share of the draws that agree, and what being wrong costs |
# | which plan? | gains on held-out draws, in the mean and in the tail |
# | is caution worth anything here? | what it gains in the tail against what it gives up |
# | is another study worth it? | its expected worth against that of perfect knowledge |
#
# ## What not to conclude
#
# - That never helping is right: the default prior shrinks the effect of help
#   ([notebook 04](04_how_sure_are_we.ipynb)), and 540 people leave the question open, which is what the value of
#   information says.
# - That doubt is covered. All of it is the doubt of *this model's* draws; if latent states are the wrong idea, none of
#   these draws is true.
# - That the plan in front is the one to build. Where several are worth the same, take the one that can be explained.
#
# Next: [the token game and study 2](08_the_token_game.ipynb): plans meet people who play.
