"""The recovery study in words, made from its numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from analysis.figures.style import spoken
from analysis.rank_uniformity import FAMILY_WISE
from analysis.recovery_quantities import EFFECTS
from analysis.wording import counted

if TYPE_CHECKING:
    from analysis.recovery import Recovery

NARROW = 3.0
"""Standard errors that a coverage may stay below its level before intervals are called too narrow."""

ENOUGH = 10
"""Studies from which a standard error over studies is worth something."""


def sentence(recovery: Recovery) -> str:
    """What is recovered and what is not."""
    own = recovery.settings
    parts = [
        f"{counted(own.replicates, 'simulated study', 'simulated studies')} of "
        f"{counted(own.participants, 'person', 'people')} whose truth has "
        f"{counted(own.true_states, 'state')} ({recovery.truth_name})."
    ]
    parts += [_of(recovery, k) for k in sorted(own.states, key=lambda k: (k != own.true_states, k))]
    if own.select:
        parts.append(_found(recovery))
    return " ".join(parts)


def _of(recovery: Recovery, states: int) -> str:
    own = recovery.settings
    coverage = recovery.pooled_coverage(states)
    (mean, error), (half, half_error) = coverage["coverage_90"], coverage["coverage_50"]
    text = f"With {counted(states, 'state')}"
    if states == own.true_states:
        text += f", the true number, {_errors(recovery, states)}; 90% posterior intervals hold the true entry"
    else:
        text += " 90% posterior intervals hold the true effect"
    text += f" in {_share(mean, error)}, 50% intervals in {_share(half, half_error)}"
    if own.replicates >= ENOUGH and mean < 0.9 - NARROW * error:
        text += ": too narrow for this truth"
    text += f"{_missed(recovery, states)}; {_effects(recovery, states)}{_failures(recovery, states)}."
    return text


def _errors(recovery: Recovery, states: int) -> str:
    """How far entries of the transition tables are off, by learner."""
    table = recovery.by_table
    rows = table[table["states"] == states].set_index("table")
    moves = rows[rows.index.str.startswith("moves")]
    tables = moves if len(moves) else rows[rows.index.str.startswith("responses")]
    em, mean, guess = (
        float(np.sqrt(np.average(tables[c] ** 2, weights=tables["entries"])))
        for c in ("em_rmse", "rmse", "prior_rmse")
    )
    text = (
        f"{'transition entries' if len(moves) else 'response probabilities'} are off by {em:.2f} (EM), {mean:.2f} "
        f"(posterior mean) and {guess:.2f} (the prior's mean, without any data; root mean squares), median "
        f"contraction {float(tables['contraction'].median()):.2f}"
    )
    if recovery.settings.bootstrap:
        entries = rows.drop(index=EFFECTS)
        boot = float(np.average(entries["boot_coverage_90"], weights=entries["entries"]))
        text += f"; 90% bootstrap intervals of EM hold the true entry in {boot:.0%}"
    return text


def _missed(recovery: Recovery, states: int) -> str:
    """Entries whose intervals miss a truth far more often than they say: an average can hide them."""
    own, table = recovery.settings, recovery.table
    rows = table[table["states"] == states].reset_index(drop=True)
    if states == own.true_states:
        rows = rows[rows["table"] != EFFECTS]
    held = np.round(rows["coverage_90"].to_numpy() * own.replicates)
    few = rows[stats.binom.cdf(held, own.replicates, 0.9) < FAMILY_WISE / len(rows)]
    if few.empty:
        return ""
    worst = few.loc[few["coverage_90"].idxmin()]
    where = spoken(f"{worst['table']}, {worst['entry']}" if worst["table"] != EFFECTS else worst["entry"])
    return f" ({len(few)} of {len(rows)} held too seldom, most so '{where}': in {worst['coverage_90']:.0%})"


def _effects(recovery: Recovery, states: int) -> str:
    """Effects of always acting, in percentage points."""
    table = recovery.table
    rows = table[(table["states"] == states) & (table["table"] == EFFECTS)]
    told = [
        f"'{row.entry}' ({100 * row.truth:+.1f}) by {100 * row.bias:+.1f} (EM {100 * row.em_bias:+.1f}), held in "
        f"{row.coverage_90:.0%}"
        for row in rows.itertuples()
        if row.entry.startswith("always ")
    ]
    return f"the posterior mean is off, on average and in percentage points, for {'; '.join(told)}"


def _failures(recovery: Recovery, states: int) -> str:
    failed, n = recovery.gate_failures(states), recovery.settings.replicates
    text = ""
    if failed:
        mean, error = recovery.pooled_coverage(states, passed_only=True)["coverage_90"]
        rest = f" (without them 90% intervals hold in {_share(mean, error)})" if failed < n else ""
        text = f"; {failed} of {counted(n, 'sample')} failed the convergence gate and are counted too{rest}"
    capped = recovery.em_failures(states)
    return text + (f"; EM did not converge in {capped}" if capped else "")


def _found(recovery: Recovery) -> str:
    """How often the true number of states is chosen."""
    own, chosen = recovery.settings, recovery.chosen
    told = []
    for _, rows in chosen.groupby("criterion", sort=False):
        right = int(rows.loc[rows["states"] == own.true_states, "studies"].sum())
        most = rows.loc[rows["studies"].idxmax()]
        told.append(
            f"{rows['name'].iloc[0]} in {right} (most often {counted(int(most['states']), 'state')}, "
            f"in {int(most['studies'])})"
        )
    if own.true_states not in own.states:
        return f"The true number of states, {own.true_states}, was not among those fitted."
    return (
        f"Of {counted(own.replicates, 'study', 'studies')} the true number of states, {own.true_states}, is found "
        f"by {', '.join(told)}."
    )


def _share(mean: float, error: float) -> str:
    return f"{mean:.0%}" if np.isnan(error) else f"{mean:.0%} ± {100 * error:.0f}"
