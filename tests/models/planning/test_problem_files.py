"""Written and read back: same numbers, same values, whichever form a problem had to be brought into."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.planning.formats import SUFFIXES, read_problem, write_problem
from models.planning.formats.end_state import flat, observed_end, same_actions
from models.planning.formats.words import legal_names, number
from models.planning.latent import latent_problem
from models.planning.mode_process import bernoulli, mode_table
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.problems import PROBLEMS
from models.protocol import PUBLISHED
from tests.random_cases import random_tables
from tests.reference.planning import horizon_value


def model(seed, n_states=3):
    return LatentStatePOMDP(*random_tables(np.random.default_rng(seed), PUBLISHED, n_states), PUBLISHED)


def agrees(problem, path, horizon, **more):
    write_problem(problem, path, **more)
    assert horizon_value(read_problem(path), horizon) == pytest.approx(horizon_value(problem, horizon), abs=1e-9)


# -- observations of the start -------------------------------------------------------------------------
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("horizon", [1, 2, 3, 4])
def test_observations_of_the_start_survive(suffix, horizon, tmp_path):
    agrees(latent_problem(model(horizon)), tmp_path / f"a{suffix}", horizon)


def test_the_last_observation_goes_into_the_mode():
    problem = latent_problem(model(1))
    folded = observed_end(problem)
    assert folded.modes == ("human_needs_help,no_help", "human_needs_help,help", "robot_needs_help,none")
    assert folded.n_states == problem.n_states
    assert folded.observations == ("none",)
    assert flat(problem).n_states == 9


@pytest.mark.parametrize("seed", range(4))
def test_every_form_has_the_same_value(seed):
    rng = np.random.default_rng(seed)
    process = mode_table(PUBLISHED, rng.dirichlet(np.ones(2), 2), start="R")
    problem = latent_problem(model(seed, 2 + seed % 3), process, 0.9)
    wanted = horizon_value(problem, 3)
    for form in (same_actions, observed_end, flat):
        assert horizon_value(form(problem), 3) == pytest.approx(wanted, abs=1e-9)


def test_a_first_mode_of_chance_needs_modes(tmp_path):
    problem = latent_problem(model(3), bernoulli(PUBLISHED, 0.3))
    agrees(problem, tmp_path / "a.pomdpx", 3)
    with pytest.raises(InputError, match=r"starts in one of 2 modes .*hide_start=True"):
        write_problem(problem, tmp_path / "a.pomdp")
    write_problem(problem, tmp_path / "a.pomdp", hide_start=True)
    assert horizon_value(read_problem(tmp_path / "a.pomdp"), 3) <= horizon_value(problem, 3) + 1e-12


# -- random problems of every kind ---------------------------------------------------------------------
@st.composite
def problems(draw):
    """Any joint kernel: branches of start or end observations, modes of different sizes and actions."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    sizes = draw(st.lists(st.integers(1, 3), min_size=1, max_size=3))
    n_kinds = draw(st.integers(1, 3))
    start_seen = draw(st.booleans())
    choices = []
    for n in sizes:
        offered = []
        for a in range(draw(st.integers(1, 3))):
            ends = draw(st.lists(st.integers(0, len(sizes) - 1), min_size=1, max_size=2, unique=True))
            table = rng.dirichlet(np.full(sum(sizes[x] for x in ends), 0.5), n)
            table[table < 0.05] = 0
            table /= table.sum(axis=1, keepdims=True)
            branches, at = [], 0
            for x in ends:
                part = table[:, at : at + sizes[x]]
                at += sizes[x]
                if start_seen:
                    seen = rng.dirichlet(np.ones(n_kinds), n)
                    branches += [Branch(x, csr(part * seen[:, [o]]), (o,)) for o in range(n_kinds)]
                else:
                    seen = np.random.default_rng((7, a, x)).dirichlet(np.ones(n_kinds), sizes[x])
                    branches.append(Branch(x, csr(part), tuple(range(n_kinds)), csr(seen)))
            offered.append(Choice(f"do {a}", rng.normal(size=n).round(1), tuple(branches)))
        choices.append(tuple(offered))
    first = draw(st.integers(0, len(sizes) - 1))
    initial = tuple(rng.dirichlet(np.ones(n)) if x == first else np.zeros(n) for x, n in enumerate(sizes))
    return Problem(
        tuple(f"mode {x}" for x in range(len(sizes))), tuple(tuple(f"{y}" for y in range(n)) for n in sizes),
        tuple(choices), tuple(f"kind {o}" for o in range(n_kinds)), initial, 0.9, "random", draw(st.booleans()),
    )  # fmt: skip


@settings(max_examples=60)
@given(problems(), st.sampled_from([".pomdp", ".pomdpx"]))
def test_any_problem_keeps_its_value(tmp_path_factory, problem, suffix):
    agrees(problem, tmp_path_factory.getbasetemp() / f"any{suffix}", 2)


@given(problems())
def test_forms_are_what_they_say(problem):
    folded, single = observed_end(problem), flat(problem)
    for offered in folded.choices:
        assert [c.action for c in offered] == [c.action for c in folded.choices[0]]
        for choice in offered:
            ends = [b.mode for b in choice.branches]
            assert len(set(ends)) == len(ends)
    assert single.n_modes == 1
    assert all(len(c.branches) == 1 for c in single.choices[0])
    wanted = horizon_value(problem, 2)
    assert horizon_value(folded, 2) == pytest.approx(wanted, abs=1e-9)
    assert horizon_value(single, 2) == pytest.approx(wanted, abs=1e-9)


# -- exact numbers -------------------------------------------------------------------------------------
def emission(problem, choice):
    """Emission over all observations of the problem: those that never occur may have been left out."""
    branch = choice.branches[0]
    n = branch.transition.shape[1]
    table = np.zeros((n, len(problem.observations)))
    table[:, list(branch.observations)] = np.ones((n, 1)) if branch.emission is None else branch.emission.toarray()
    return table


def assert_same_bits(one, other):
    assert (one.states, one.observations, one.discount) == (other.states, other.observations, other.discount)
    assert one.initial[0].tobytes() == other.initial[0].tobytes()
    for a, b in zip(one.choices[0], other.choices[0], strict=True):
        assert a.action == b.action
        assert (a.reward + 0.0).tobytes() == (b.reward + 0.0).tobytes()
        assert a.branches[0].transition.toarray().tobytes() == b.branches[0].transition.toarray().tobytes()
        assert emission(one, a).tobytes() == emission(other, b).tobytes()


@pytest.mark.parametrize("suffix", [".pomdp", ".pomdpx", ".pomdp.gz"])
@pytest.mark.parametrize("name", ["1d", "4x3.95", "aloha.10", "cheese.95", "ejs1", "hallway", "network", "paint.95",
                                  "shuttle.95", "tag-avoid", "tiger.95", "tiger.aaai"])  # fmt: skip
def test_files_in_circulation_come_back_bit_by_bit(shared, tmp_path, name, suffix):
    problem = read_problem(shared / "data" / "pomdp" / f"{name}.pomdp")
    write_problem(problem, tmp_path / f"a{suffix}")
    back = read_problem(tmp_path / f"a{suffix}")
    if name in ("4x3.95", "cheese.95", "shuttle.95", "hallway", "aloha.10") and suffix == ".pomdpx":
        problem = read_problem(_renamed(problem, back, tmp_path))
    assert_same_bits(problem, back)


def _renamed(problem, back, folder):
    """States and the like that are numbers have names in `.pomdpx`: the same problem with those names."""
    choices = tuple(replace(c, action=b.action) for c, b in zip(problem.choices[0], back.choices[0], strict=True))
    named = replace(problem, states=back.states, observations=back.observations, choices=(choices,))
    write_problem(named, folder / "named.pomdp")
    return folder / "named.pomdp"


def test_costs_are_costs_again(tmp_path):
    text = "discount: 0.9\nvalues: cost\nstates: 2\nactions: 1\nobservations: 1\nT: 0 identity\nO: 0 uniform\n"
    (tmp_path / "a.pomdp").write_text(text + "R: * : * : * : * 2\nR: 0 : 1 : 0 : 0 7\nR: 0 : 1 : 1 : 0 3.5")
    problem = read_problem(tmp_path / "a.pomdp")
    assert problem.choices[0][0].reward.tolist() == [-2, -3.5]
    write_problem(problem, tmp_path / "b.pomdp")
    assert "values: cost" in (tmp_path / "b.pomdp").read_text()
    assert_same_bits(problem, read_problem(tmp_path / "b.pomdp"))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_keep_every_digit(value):
    assert float(number(value)) == value
    assert "." in number(value).partition("e")[0]


@given(st.lists(st.text(max_size=4), max_size=6))
def test_names_are_legal_and_different(names):
    legal = legal_names(names, "s", ("T", "uniform"))
    assert len(set(legal)) == len(names)
    assert all(n[0].isalpha() and n.isascii() and n.replace("_", "").replace("-", "").isalnum() for n in legal)
    assert not {"T", "uniform"} & set(legal)


@pytest.mark.parametrize("name", ["tiger", "crying_baby", "rock_sample_4_4", "tag"])
@pytest.mark.parametrize("suffix", [".pomdp", ".pomdpx"])
def test_standard_problems_come_back(name, suffix, tmp_path):
    problem = PROBLEMS[name]()
    horizon = 1 if name == "tag" else 2
    write_problem(problem, tmp_path / f"a{suffix}", hide_start=name == "tag")
    back = read_problem(tmp_path / f"a{suffix}")
    if suffix == ".pomdpx":
        assert (back.n_modes, back.n_states) == (problem.n_modes, problem.n_states)
    if name != "tag" or suffix == ".pomdpx":
        assert horizon_value(back, horizon) == pytest.approx(horizon_value(problem, horizon), abs=1e-9)
