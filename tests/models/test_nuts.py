"""Chains: the callbacks are the density, streams depend on seed and number only, interrupted runs go on."""

import ctypes
import time

import numpy as np
import pytest

from analysis.simulate import simulate_study1
from models import chains as runs
from models import nuts
from models.errors import InputError
from models.hmm_density import HmmDensity
from models.nuts import Chain, NutsSettings, address_table, sample, sample_chain
from models.parameters import STICKY, Layout, checked_pins
from models.protocol import PUBLISHED

SHORT = NutsSettings(draws=40, tune=60, chains=3, seed=5)


def density_of(states=2, pins=None, people=60):
    layout = Layout(PUBLISHED, states)
    log = simulate_study1(participants=people)
    return HmmDensity(log.tree(), layout, 1 + STICKY.pseudo_counts(layout), checked_pins(layout, pins or {}))


@pytest.mark.parametrize(("states", "pins"), [(1, {}), (2, {}), (3, {"help": None})])
def test_the_callback_is_the_density(states, pins):
    density = density_of(states, pins)
    table, kept = address_table(density)
    assert len(kept) == nuts.ARRAYS
    rng = np.random.default_rng(1)
    pointer = ctypes.POINTER(ctypes.c_double)
    for _ in range(3):
        x, gradient, value = rng.normal(size=density.dimension), np.empty(density.dimension), np.empty(1)
        status = nuts.callback_of(density).ctypes(
            density.dimension, *(a.ctypes.data_as(pointer) for a in (x, gradient, value)), table.ctypes.data
        )
        wanted, slope = density(x)
        assert status == 0
        assert value[0] + density.constant == pytest.approx(wanted, rel=1e-14)
        assert np.array_equal(gradient, slope)
    x[0] = np.nan
    assert nuts.callback_of(density).ctypes(
        density.dimension, *(a.ctypes.data_as(pointer) for a in (x, gradient, value)), table.ctypes.data
    ) in (3, 4)


def same(one: Chain, other: Chain) -> bool:
    return np.array_equal(one.x, other.x) and all(np.array_equal(one.stats[k], other.stats[k]) for k in one.stats)


@pytest.fixture(scope="module")
def chains():
    return sample(density_of(), SHORT)


def test_shapes_and_statistics(chains):
    assert list(chains) == [0, 1, 2]
    density = density_of()
    for chain in chains.values():
        assert chain.x.shape == (40, density.dimension)
        assert set(chain.stats) == set(nuts.STATS)
        assert all(len(v) == 40 for v in chain.stats.values())
        assert chain.stats["lp"][-1] + density.constant == pytest.approx(density(chain.x[-1])[0], rel=1e-12)


def test_a_chain_depends_on_seed_and_number_only(chains):
    """Whether alone or among others: bit for bit."""
    for c in (2, 0):
        assert same(sample_chain(density_of(), c, NutsSettings(draws=40, tune=60, chains=1, seed=5)), chains[c])
    assert not same(chains[0], chains[1])
    assert not same(sample_chain(density_of(), 0, NutsSettings(draws=40, tune=60, seed=6)), chains[0])


def test_an_interrupted_run_goes_on(chains):
    """Chain 1 was done, chains 0 and 2 are made, each handed over once; nothing that was done is made again."""
    marked = Chain(chains[1].x + 1, chains[1].stats, 123.0)
    handed: dict[int, Chain] = {}
    result = sample(density_of(), SHORT, done={1: marked}, finished=handed.__setitem__)
    assert sorted(handed) == [0, 2]
    assert result[1] is marked
    assert all(same(result[c], chains[c]) for c in (0, 2))
    assert sample(density_of(), SHORT, done=result) == result


def test_completed_chains_are_handed_over_before_an_interruption(monkeypatch, chains):
    def interrupted(target, chain, settings, *rest):
        if chain == 1:
            raise KeyboardInterrupt
        return chains[chain]

    monkeypatch.setattr(runs, "sample_chain", interrupted)
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    handed: dict[int, Chain] = {}
    with pytest.raises(KeyboardInterrupt):
        sample(density_of(), SHORT, finished=handed.__setitem__)
    assert set(handed) <= {0, 2}
    assert 0 in handed


def test_chains_beyond_what_is_asked_for_are_left_out(chains):
    two = NutsSettings(draws=40, tune=60, chains=2, seed=5)
    assert list(sample(density_of(), two, done=chains)) == [0, 1]


def test_chains_know_their_cpu_time():
    """Together they took what the process took, whether one at a time or two."""
    density = density_of()
    sample(density, SHORT)
    settings = NutsSettings(draws=800, tune=400, chains=3)
    before = time.process_time()
    made = sample(density, settings)
    spent = time.process_time() - before
    each = [chain.cpu_seconds for chain in made.values()]
    assert min(each) > 0
    assert 0.7 * spent < sum(each) <= spent


def test_progress_ends_at_the_total():
    seen = []
    sample(density_of(), NutsSettings(draws=2000, tune=400, chains=1), progress=lambda *now: seen.append(now))
    assert seen
    assert {s[0] for s in seen} == {"sampling"}
    assert {s[2] for s in seen} == {2400}
    counts = [s[1] for s in seen]
    assert counts == sorted(counts)
    assert counts[-1] <= 2400


@pytest.mark.parametrize(
    ("name", "value"),
    [("draws", 3), ("tune", 10), ("chains", 0), ("seed", -1), ("draws", 10.5), ("chains", True),
     ("target_accept", 1.0), ("target_accept", 0.2)],
)  # fmt: skip
def test_settings_that_make_no_sense(name, value):
    with pytest.raises(InputError, match=f"sampling, {name}: found"):
        NutsSettings(**{name: value})
