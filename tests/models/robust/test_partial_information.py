"""The value of knowing one block of the tables: where it is known exactly, its bounds, and its two estimates."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.model_draws import ModelDraws
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.robust.block_smoother import Terms, block_features, block_names, block_words, equal_blocks
from models.robust.block_worth import BlockWorth, PartialInformation
from models.robust.draw_groups import DrawGroups
from models.robust.information import perfect_information
from models.robust.partial_information import _best_elsewhere, _Cells, partial_information
from tests.models.robust.information_cases import cloud, contested, doubts
from tests.reference.information import grouped_value

CLOSE = {"rel": 1e-9, "abs": 1e-9}


def crossed(seed, helps=2, others=2, copies=1):
    """Every combination of some tables of one action with some of everything else; and which of the former."""
    one, two = contested(seed, helps), contested(seed + 1000, others)
    pairs = list(product(range(helps), range(others))) * copies
    transition = two.transition[[j for _, j in pairs]].copy()
    action = PUBLISHED.action_names.index("help")
    transition[:, action] = one.transition[[i for i, _ in pairs], action]
    rest = [j for _, j in pairs]
    weight = np.full(len(pairs), 1.0 / len(pairs))
    draws = ModelDraws(PUBLISHED, two.initial[rest], transition, two.emission[rest], weight, reward=two.reward)
    return draws, np.array([i for i, _ in pairs])


@pytest.mark.parametrize("seed", range(8))
def test_few_values_of_a_block_are_known_exactly(seed):
    """A block with two values puts the draws into two cells: the value of being told which one."""
    draws, group = crossed(seed, 2, 3, copies=20)
    schedule = Schedule.of(draws, "RHRH")
    row = partial_information(schedule, ["transition[help]"]).rows[0]
    few, few_group = crossed(seed, 2, 3)
    assert row.in_sample == pytest.approx(grouped_value(Schedule.of(few, "RHRH"), few_group), **CLOSE)
    assert np.array_equal(group[:6], few_group)
    # Each value is met in every part of the draws, and so the rule made without a part is the right one there.
    assert row.worth == pytest.approx(row.in_sample, **CLOSE)
    # The penalty of the regression only shrinks.
    assert row.regression <= row.in_sample + 1e-9


def test_some_of_these_are_worth_something():
    worth = [
        partial_information(Schedule.of(crossed(s, 2, 3, 8)[0], "RHRH"), ["transition[help]"]) for s in range(8)
    ]
    assert sum(p.rows[0].in_sample > 0.01 for p in worth) >= 2
    assert max(p.rows[0].in_sample / p.perfect for p in worth if p.perfect > 0) > 0.2


@settings(max_examples=15)
@given(doubts(max_draws=12), st.sampled_from([1, 2]))
def test_between_zero_and_the_pool(schedule, kinds):
    if schedule.draws.n_draws % kinds:
        kinds = 1
    found = partial_information(schedule, kinds=kinds)
    perfect = perfect_information(schedule, kinds=kinds).value
    assert found.perfect == perfect
    assert 0 <= found.pool <= perfect + 1e-9
    for row in found.rows:
        assert 0 <= row.in_sample <= found.pool + 1e-9


@pytest.fixture(scope="module")
def posterior():
    return Schedule.of(cloud(7, 600, spread=6.0), "RHRHRH")


def test_estimates_agree(posterior):
    """In the sample, cross-fitted, and by regression alone: three ways, one answer."""
    found = partial_information(posterior)
    assert found.perfect > 0.05
    for row in found.rows:
        assert row.in_sample <= found.pool + 1e-12
        # Choosing on the draws that score is optimistic, a rule made without them is not.
        assert row.worth <= row.in_sample + 2 * row.se
        assert abs(row.worth - row.in_sample) < 4 * row.se + 0.15 * found.perfect
        assert abs(row.regression - row.worth) < 4 * row.se + 0.1 * found.perfect
    assert max(r.worth for r in found.rows) > 0.1 * found.perfect
    assert len(found.table) == len(block_names(PUBLISHED)) == len(found.sentences)
    assert "reward units a person" in found.sentence


def test_a_block_that_says_nothing_of_values_is_optimistic_in_the_sample_only(posterior):
    """The tables of help mean nothing where the robot never may help: nothing to gain, whatever chance suggests."""
    draws = posterior.draws
    row = partial_information(Schedule.of(draws, "HHH"), ["transition[help]"]).rows[0]
    assert row.in_sample >= 0
    assert row.worth <= 3 * row.se


def test_large_samples_agree_with_fresh_draws():
    """Estimates from 600 draws against those from all 6,000, where cells hold many draws."""
    draws = cloud(12, 6000, spread=6.0)
    large = partial_information(Schedule.of(draws, "RHRH"), ["transition[no_help]", "transition[signal]"])
    small = []
    for part in range(10):
        keep = slice(600 * part, 600 * part + 600)
        some = replace(
            draws, initial=draws.initial[keep], transition=draws.transition[keep], emission=draws.emission[keep],
            weight=np.full(600, 1 / 600),
        )  # fmt: skip
        rows = partial_information(Schedule.of(some, "RHRH"), ["transition[no_help]", "transition[signal]"]).rows
        small.append([(r.worth, r.in_sample, r.se) for r in rows])
    worth, optimistic, se = np.moveaxis(np.array(small), -1, 0)
    truth = np.array([(r.worth + r.in_sample) / 2 for r in large.rows])
    error = np.sqrt((se**2).mean(axis=0) / 10)
    assert np.all(worth.mean(axis=0) <= truth + 3 * error)
    assert np.all(optimistic.mean(axis=0) >= truth - 3 * error)
    assert np.all(optimistic.mean(axis=0) >= worth.mean(axis=0))
    assert worth.std(axis=0, ddof=1) == pytest.approx(se.mean(axis=0), rel=0.7)


def test_one_draw_and_held_tables_are_worth_nothing():
    one = Schedule.of(contested(3, 1), "HRHRH")
    found = partial_information(one)
    assert [r.in_sample for r in found.rows] == [0.0] * len(found.rows)
    assert "1 draw is too few" in found.sentence
    draws, _ = crossed(1, 2, 1)
    held = partial_information(Schedule.of(draws, "RH"), ["emission", "transition[help]"])
    assert held.rows[0].probabilities == 0
    assert "held fixed" in held.rows[0].sentence
    assert held.rows[1].probabilities > 0


def test_duplicates_of_draws_change_nothing():
    draws, _ = crossed(2, 2, 3, copies=4)
    twice = replace(
        draws, initial=np.repeat(draws.initial, 2, axis=0), transition=np.repeat(draws.transition, 2, axis=0),
        emission=np.repeat(draws.emission, 2, axis=0), weight=np.repeat(draws.weight, 2) / 2,
    )  # fmt: skip
    a, b = (partial_information(Schedule.of(d, "RHRH")) for d in (draws, twice))
    assert [r.in_sample for r in b.rows] == pytest.approx([r.in_sample for r in a.rows], **CLOSE)


def test_nothing_depends_on_the_executor(posterior):
    blocks, done = ["initial", "transition[help]"], []
    plain = partial_information(posterior, blocks, progress=lambda *x: done.append(x))
    with ThreadPoolExecutor(1) as one:
        assert partial_information(posterior, blocks, executor=one).table.equals(plain.table)
    assert done == [(1, 2), (2, 2)]


def test_chains(posterior):
    plain = partial_information(posterior, ["transition[help]"]).rows[0]
    chained = partial_information(posterior, ["transition[help]"], chains=4, folds=3).rows[0]
    assert chained.se >= 0.99 * plain.se or abs(chained.worth - plain.worth) < 3 * plain.se
    assert chained.in_sample == plain.in_sample


def test_what_is_refused(posterior):
    with pytest.raises(InputError, match=r"block of the tables: found 'transition\[hug\]', wanted one of"):
        partial_information(posterior, ["transition[hug]"])
    with pytest.raises(InputError, match=r"folds: found 1, wanted an integer of at least 2"):
        partial_information(posterior, folds=1)
    with pytest.raises(InputError, match=r"chains: found 7, wanted a number that divides the 600 draws"):
        partial_information(posterior, chains=7)
    strange = perfect_information(Schedule.of(contested(1, 4), "HR"))
    with pytest.raises(InputError, match=r"perfect information, draws: found 4 of 1 kinds"):
        partial_information(posterior, perfect=strange)


def test_sentences():
    row = BlockWorth("transition[help]", 1.234, 0.051, 1.4, 1.3, 5, 12)
    assert row.sentence == (
        "Knowing how help moves people would be worth 1.2 reward units a person (cross-fitted, standard error "
        "0.05), and 1.4 if scored on the draws that the plans were chosen with."
    )
    assert replace(row, worth=-0.01).sentence.endswith("that may be nothing at all.")
    assert "0 reward units" in replace(row, worth=-0.01).sentence
    assert "as far as these draws tell: no rule was found" in replace(row, in_sample=0.0).sentence
    few = replace(row, worth=float("nan"), se=float("nan"))
    assert few.sentence.endswith("which is too much).")
    assert "too few draws" in replace(few, in_sample=0.0).sentence
    assert "whatever" not in replace(few, in_sample=0.0).sentence
    sure = replace(row, se=float("nan"), in_sample=1.234, exact=True)
    assert sure.sentence == "Knowing how help moves people would be worth 1.2 reward units a person."
    assert "today's plan is the best one" in replace(sure, worth=0.0, in_sample=0.0).sentence
    assert "the same in all of these models" in replace(sure, probabilities=0).sentence


def test_the_most_worth_knowing_in_words():
    one = BlockWorth("transition[help]", 3.2, 0.7, 3.5, 3.3, 5, 12)
    two, three = replace(one, block="initial", worth=3.0, se=0.6), replace(one, block="emission", worth=0.2, se=0.1)
    found = PartialInformation((two, one, three), 8.0, 7.0, 9, 4, None, 400)
    assert found.sentence == (
        "Most worth knowing is how help moves people: 3.2 reward units a person (standard error 0.7), of 8 that "
        "perfect knowledge of all tables would be worth; as far as the errors tell how people start (3) may be "
        "worth as much."
    )
    assert "as much" not in replace(found, rows=(one, three)).sentence
    nan = float("nan")
    all_of_it = [replace(r, worth=8.0, se=nan, exact=True) for r in (one, two)]
    less = replace(three, se=nan, exact=True)
    exact = replace(found, rows=(*all_of_it, less), exact=True, draws=3)
    assert exact.sentence.startswith("Knowing any of 2 blocks (how help moves people; how people start) would")
    assert replace(exact, rows=tuple(all_of_it)).sentence.startswith("Knowing any single block of the tables")
    assert replace(exact, rows=(less,)).sentence.endswith("tables would be worth.")
    assert "as far as" not in replace(exact, rows=(replace(less, worth=0.0),)).sentence


# -- lists of models -----------------------------------------------------------------------------
def same_table(draws, block, kinds):
    """Which rows have a block in common with each other, all kinds of people together; by looking."""
    table, _, action = block.rstrip("]").partition("[")
    values = getattr(draws, table)
    if action:
        names = PUBLISHED.action_names if table == "transition" else PUBLISHED.emission_actions
        values = values[:, names.index(action)]
    seen = values.reshape(draws.n_draws // kinds, -1).round(9)
    return np.unique(seen, axis=0, return_inverse=True)[1].ravel().repeat(kinds)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kinds", [1, 2])
def test_blocks_of_a_list_are_worth_what_being_told_them_is(seed, kinds):
    draws, _ = crossed(seed, 3, 4)
    schedule = Schedule.of(draws, "RHRH")
    perfect = perfect_information(schedule, kinds=kinds, sampled=False)
    done = []
    found = partial_information(schedule, kinds=kinds, perfect=perfect, progress=lambda *x: done.append(x))
    assert found.exact
    assert found.enough
    assert done[-1] == (len(found.rows), len(found.rows))
    for row in found.rows:
        told = grouped_value(schedule, same_table(draws, row.block, kinds))
        assert row.worth == pytest.approx(told, **CLOSE)
        assert row.in_sample == row.worth <= found.perfect + 1e-9
        assert np.isnan(row.se)


def test_such_lists_are_worth_telling_apart():
    """Blocks between nothing and everything, or the test before says little."""
    shares = []
    for seed in range(6):
        schedule = Schedule.of(crossed(seed, 3, 4)[0], "RHRH")
        found = partial_information(schedule, perfect=perfect_information(schedule, sampled=False))
        shares += [r.worth / found.perfect for r in found.rows if found.perfect > 1e-6]
    assert sum(0.02 < s < 0.98 for s in shares) >= 3
    assert max(shares) > 0.9


@pytest.mark.parametrize("seed", range(5))
def test_blocks_that_tell_the_models_apart_are_worth_perfect_knowledge(seed):
    schedule = Schedule.of(cloud(seed, 5, spread=2.0), "RHRH")
    perfect = perfect_information(schedule, sampled=False)
    assert perfect.value > 0
    for row in partial_information(schedule, perfect=perfect).rows:
        assert row.worth == pytest.approx(perfect.value, rel=1e-9)


def test_models_without_weight_tell_nothing():
    draws, _ = crossed(2, 2, 3)
    keep = np.arange(len(draws.weight)) < 3
    none = replace(draws, weight=keep / keep.sum())
    schedule = Schedule.of(none, "RHRH")
    found = partial_information(
        schedule, ["transition[help]"], perfect=perfect_information(schedule, sampled=False)
    )
    assert found.rows[0].worth == 0


def test_equal_blocks():
    draws, group = crossed(5, 2, 3)
    groups = DrawGroups.of(draws)
    found = equal_blocks(draws, groups, "transition[help]")
    assert np.array_equal(found[:, None] == found, group[:, None] == group)
    noise = replace(draws, transition=draws.transition + 1e-15)
    assert np.array_equal(equal_blocks(noise, groups, "transition[help]"), found)
    pairs = equal_blocks(draws, DrawGroups.of(draws, 3), "emission")
    assert len(set(pairs.tolist())) == 1


def test_a_block_is_worth_its_parts(posterior):
    found = {r.block: r for r in partial_information(posterior).rows}
    whole, parts = found["emission"], [found[f"emission[{a}]"] for a in PUBLISHED.emission_actions]
    assert all(whole.in_sample >= p.in_sample for p in parts)
    assert whole.worth >= max(p.worth for p in parts) - 2 * whole.se - 2 * max(p.se for p in parts)
    # What is said of a block does not depend on what else was asked.
    assert partial_information(posterior, ["emission"]).rows[0] == whole


def test_the_rule_of_the_other_parts():
    fold = np.array([0, 0, 1, 1])
    first = _Cells(np.zeros(4, int), (), np.array([5.0, 5.0, 0.0, 0.0]), 0.0)
    second = replace(first, gain=np.array([1.0, 1.0, 2.0, 2.0]))
    gain = _best_elsewhere([first, second], np.full(4, 0.25), fold)
    assert gain.tolist() == [1.0, 1.0, 0.0, 0.0]
    assert block_words("emission[no_signal]") == "how each state responds to no signal"
    assert block_words("transition") == "how people move"


# -- the smoother --------------------------------------------------------------------------------
def test_smoother_finds_a_quadratic():
    """Exact without noise; with noise as good as least squares with the true terms, nearly."""
    rng = np.random.default_rng(5)
    x = rng.normal(size=(500, 3))
    truth = np.column_stack([1 + x[:, 0] * x[:, 1] - x[:, 2] ** 2, 2 * x[:, 1]])
    weight = rng.dirichlet(np.full(500, 5.0))
    assert Terms.of(x, weight).fit(truth).predict(x) == pytest.approx(truth, abs=1e-8)
    noisy = Terms.of(x, weight).fit(truth + rng.normal(size=truth.shape)).predict(x)
    assert np.sqrt(np.mean((noisy - truth) ** 2)) < 0.25
    flat = Terms.of(x, weight).fit(rng.normal(size=(500, 1))).predict(x)
    assert flat.std() < 0.2


def test_smoother_keeps_means_and_ignores_draws_without_weight():
    rng = np.random.default_rng(6)
    x, y = rng.normal(size=(60, 2)), rng.normal(size=(60, 2))
    weight = rng.dirichlet(np.ones(60)) * (np.arange(60) < 40)
    weight /= weight.sum()
    y[40:] = 1e6
    found = Terms.of(x, weight).fit(y)
    assert weight @ found.predict(x) == pytest.approx(weight @ y)
    assert Terms.of(x[:40], weight[:40]).fit(y[:40]).slope == pytest.approx(found.slope)
    few = Terms.of(x[:5], np.full(5, 0.2))
    assert few.order == 0
    constant = Terms.of(np.ones((5, 1)), np.full(5, 0.2)).fit(y[:5])
    assert constant.predict(np.ones((2, 1))) == pytest.approx(np.tile(y[:5].mean(axis=0), (2, 1)))


def test_features():
    draws = cloud(4, 6, states=3)
    assert block_features(draws, DrawGroups.of(draws), "transition[help]").shape == (6, 6)
    assert block_features(draws, DrawGroups.of(draws), "transition").shape == (6, 24)
    assert block_features(draws, DrawGroups.of(draws), "emission").shape == (6, 6)
    # Two kinds of person: their tables differ, so both tell of the block.
    assert block_features(draws, DrawGroups.of(draws, 2), "emission").shape == (3, 12)
    shared = replace(draws, initial=np.repeat(draws.initial[::2], 2, axis=0))
    assert block_features(shared, DrawGroups.of(shared, 2), "initial").shape == (3, 2)
