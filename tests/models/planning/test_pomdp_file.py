"""The `.pomdp` grammar, against tables written by hand and against a dense table filled statement by statement."""

import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.formats import read_problem
from models.planning.formats import source as file_source
from models.planning.formats.end_state import flat
from models.planning.formats.pomdp import PomdpReader
from models.planning.formats.pomdp_lexer import Words
from tests.reference.planning import horizon_value

HEAD = "discount: 0.9\nvalues: reward\nstates: low high\nactions: wait go\nobservations: dark light\n"
EVEN = "T: * uniform\nO: * uniform\n"


def read(text):
    return PomdpReader(Words(text.splitlines(), "x.pomdp"), "x").read()


def tables(problem):
    choices = problem.choices[0]
    return (
        np.stack([c.branches[0].transition.toarray() for c in choices]),
        np.stack([c.branches[0].emission.toarray() for c in choices]),
        np.stack([c.reward for c in choices]),
    )


# -- preamble and start --------------------------------------------------------------------------------
def test_preamble_in_any_order_split_over_lines_with_comments():
    text = (
        "# first\nobservations:\n dark # a comment\n light\nactions : wait\ngo\nvalues:cost\n"
        "states\n:\nlow high\ndiscount:\n.5e0\n" + EVEN + "R:go:*:*:* +3."
    )
    problem = read(text)
    assert problem.discount == 0.5
    assert problem.costs
    assert problem.states == (("low", "high"),)
    assert problem.observations == ("dark", "light")
    assert [c.action for c in problem.choices[0]] == ["wait", "go"]
    assert tables(problem)[2].tolist() == [[0, 0], [-3, -3]]


def test_counts_instead_of_names_and_numbers_instead_of_names():
    problem = read(
        "discount: 1\nvalues: reward\nstates: 2\nactions: 3\nobservations: 1\n"
        "T: * identity\nO: * uniform\nR: 2 : 1 : 0 : 0 4"
    )
    assert problem.states == (("0", "1"),)
    assert tables(problem)[2].tolist() == [[0, 0], [0, 0], [0, 0]]
    named = read(HEAD + "T: 1 : low : 1 1\nT: 1 : 1 : low 1\nT: 0 identity\nO: * uniform")
    assert tables(named)[0][1].tolist() == [[0, 1], [1, 0]]


@pytest.mark.parametrize(
    ("start", "wanted"),
    [
        ("", [1 / 3] * 3),
        ("start: uniform", [1 / 3] * 3),
        ("start: 0.2 0.3\n0.5", [0.2, 0.3, 0.5]),
        ("start: b", [0, 1, 0]),
        ("start: 2", [0, 0, 1]),
        ("start include: a c", [0.5, 0, 0.5]),
        ("start include : 0", [1, 0, 0]),
        ("start exclude: b", [0.5, 0, 0.5]),
        ("start\nexclude\n:\n1 2", [1, 0, 0]),
        ("start: 0.333333 0.333333 0.333333", [1 / 3] * 3),
    ],
)
def test_start(start, wanted):
    text = f"discount: 0.9\nstates: a b c\nactions: 1\nobservations: 1\n{start}\nT: 0 identity\nO: 0 uniform\n"
    np.testing.assert_allclose(read(text).initial[0], wanted, rtol=1e-15)


def test_one_state_with_its_probability():
    text = "discount: 0\nstates: 1\nactions: 1\nobservations: 1\nstart: 1.0\nT: 0 identity\nO: 0 1"
    assert read(text).initial[0] == 1
    assert read(text.replace("1.0", "0")).initial[0] == 1


# -- tables --------------------------------------------------------------------------------------------
def test_reset_is_the_start_distribution():
    start = "start: 0.25 0.75\n"
    row, _, _ = tables(read(HEAD + start + "T: wait : * reset\nT: go reset\nO: * uniform"))
    np.testing.assert_array_equal(row, np.full((2, 2, 2), [0.25, 0.75]))


def test_later_statements_override_earlier_ones():
    moves, seen, reward = tables(read(
        HEAD + "T: * uniform\nT: go identity\nT: go : low 0.3 0.7\nT: go : low : * 0\nT: go : low : high 1.0\n"
        "O: * : * : dark 1\nO: go : high : * 0.5\n"
        "R: * : * : * : * 1\nR: go : low : * : * 2\nR: go : * : high : dark 5\nR: wait : * : * : * 7"
    ))  # fmt: skip
    assert moves.tolist() == [[[0.5, 0.5], [0.5, 0.5]], [[0, 1], [0, 1]]]
    assert seen.tolist() == [[[1, 0], [1, 0]], [[1, 0], [0.5, 0.5]]]
    # From low, go: always high, dark half of the time. From high the same, where the general 1 was there before.
    assert reward.tolist() == [[7, 7], [0.5 * 5 + 0.5 * 2, 0.5 * 5 + 0.5 * 1]]


def test_reward_rows_and_matrices_are_averaged():
    moves, seen, reward = tables(read(
        HEAD + "T: *\n0.25 0.75\n0.5 0.5\nO: *\n0.1 0.9\n1 0\nR: go : low\n1 2\n3 4\nR: go : high : low 10 20\n"
        "R: wait : * : high : light - 6"
    ))  # fmt: skip
    wanted = 0.25 * (0.1 * 1 + 0.9 * 2) + 0.75 * (1 * 3)
    np.testing.assert_allclose(reward, [[0, 0], [wanted, 0.5 * (0.1 * 10 + 0.9 * 20)]], rtol=1e-15)
    assert moves.shape == seen.shape == (2, 2, 2)


def test_a_file_without_observations_is_seen_all_the_time():
    text = (
        "discount: 0.9\nvalues: reward\nstates: a b\nactions: stay swap\nstart: a\n"
        "T: stay identity\nT: swap\n0 1\n1 0\n"
        "R: swap : a : b 3\nR: swap : b -1 0\nR: stay\n0 0\n0 1\nR: stay : b : b : * 2"
    )
    problem = read(text)
    assert problem.modes == ("a", "b")
    assert problem.n_states == 1
    assert horizon_value(problem, 3) == pytest.approx(3 + 0.9 * 2 + 0.81 * 2, abs=1e-12)


def test_rows_close_to_one_are_normalised_and_exact_ones_left_alone():
    moves, _, _ = tables(read(HEAD + "T: * : * : low 0.333333\nT: * : * : high 0.666666\nO: * uniform"))
    np.testing.assert_allclose(moves.sum(axis=2), 1, atol=1e-15)
    kept, _, _ = tables(read(HEAD + "T: * : * 0.1 0.9\nO: * uniform"))
    assert kept[0, 0].tolist() == [0.1, 0.9]


def test_numbers_in_every_notation():
    text = HEAD + "T: * : * 1E-1 +.9\nO: * : * 1. 0e0\n" + "\n".join(
        f"R: {a} : {s} : * : * {v}" for (a, s), v in
        {(0, 0): "-1.5e+2", (0, 1): "- .25", (1, 0): "+ 3", (1, 1): "007.50"}.items()
    )  # fmt: skip
    assert tables(read(text))[2].tolist() == [[-150, -0.25], [3, 7.5]]


def distribution(draw, size):
    weights = draw(st.lists(st.integers(0, 4), min_size=size, max_size=size).filter(any))
    return np.array(weights) / sum(weights)


def joined(values):
    return " ".join(repr(float(v)) for v in np.ravel(values))


@st.composite
def files(draw):
    """Text of a file, and its tables filled in by assignment, with nothing sparse about them."""
    n, k, z = draw(st.integers(1, 4)), draw(st.integers(1, 3)), draw(st.integers(1, 3))
    moves, seen, reward = np.zeros((k, n, n)), np.zeros((k, n, z)), np.zeros((k, n, n, z))
    lines = [f"discount: 0.5\nstates: {n}\nactions: {k}\nobservations: {z}"]

    def pick(size):
        i = draw(st.integers(-1, size - 1))
        return (slice(None), "*") if i < 0 else (slice(i, i + 1), str(i))

    for _ in range(draw(st.integers(0, 12))):
        head = draw(st.sampled_from("TOR"))
        (a, wa), (s, ws), (t, wt), (o, wo) = pick(k), pick(n), pick(n), pick(z)
        form = draw(st.sampled_from(["one", "row", "all", "uniform", "uniform row", "identity"]))
        if head == "R":
            v = draw(st.integers(-5, 5))
            if form == "one":
                reward[a, s, t, o] = v
                lines.append(f"R: {wa} : {ws} : {wt} : {wo} {v}")
            elif form in ("row", "uniform row"):
                row = np.arange(z) + v
                reward[a, s, t] = row
                lines.append(f"R: {wa} : {ws} : {wt} {joined(row)}")
            else:
                matrix = np.arange(n * z).reshape(n, z) * v
                reward[a, s] = matrix
                lines.append(f"R: {wa} : {ws}\n{joined(matrix)}")
            continue
        table, width, column, word = (moves, n, t, wt) if head == "T" else (seen, z, o, wo)
        if form == "one":
            v = draw(st.sampled_from([0.0, 0.25, 1.0]))
            table[a, s, column] = v
            lines.append(f"{head} : {wa}: {ws} :{word} {v}")
        elif form == "row":
            row = distribution(draw, width)
            table[a, s] = row
            lines.append(f"{head}: {wa} : {ws}\n {joined(row)}")
        elif form == "all":
            matrix = np.stack([distribution(draw, width) for _ in range(n)])
            table[a] = matrix
            lines.append(f"{head}: {wa}\n{joined(matrix)}")
        elif form == "uniform row":
            table[a, s] = 1 / width
            lines.append(f"{head}: {wa} : {ws} uniform")
        elif form == "identity" and head == "T":
            table[a] = np.eye(n)
            lines.append(f"T: {wa}\nidentity")
        else:
            table[a] = 1 / width
            lines.append(f"{head}: {wa} uniform")
    for head, table in (("T", moves), ("O", seen)):
        for a in range(k):
            for s in range(n):
                if abs(table[a, s].sum() - 1) > 1e-12:
                    table[a, s] = distribution(draw, table.shape[2])
                    lines.append(f"{head} : {a} : {s} {joined(table[a, s])}")
    return "\n".join(lines), moves, seen, np.einsum("ast,ato,asto->as", moves, seen, reward)


@given(files())
def test_any_file_gives_the_tables_of_a_dense_reading(case):
    text, moves, seen, reward = case
    found = tables(read(text))
    np.testing.assert_allclose(found[0], moves, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found[1], seen, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found[2], reward, rtol=0, atol=1e-12)


# -- size and files ------------------------------------------------------------------------------------
def test_thousands_of_states_stay_sparse():
    n = 20_000
    text = f"discount: 0.9\nstates: {n}\nactions: 2\nobservations: 2\nT: * : * : * 0\nT: * identity\nO: * uniform\n"
    text += "R: * : * : * : * -1\nR: 1 : 7 : * : * 5\nR: 0 : * : 9 : 1 3"
    problem = read(text)
    assert problem.choices[0][0].branches[0].transition.nnz == n
    assert problem.choices[0][1].reward[[6, 7, 8]].tolist() == [-1, 5, -1]
    assert problem.choices[0][0].reward[[8, 9, 10]].tolist() == [-1, 1, -1]


def test_a_table_that_cannot_be_held_is_refused():
    text = "discount: 0.9\nstates: 100000\nactions: 2\nobservations: 2\nT: * uniform\n"
    with pytest.raises(InputError, match=r"x.pomdp, line 5: found \d+ entries.* wanted at most"):
        read(text)


def test_compressed_files_and_their_limit(tmp_path, monkeypatch):
    text = HEAD + EVEN
    (tmp_path / "a.pomdp.gz").write_bytes(gzip.compress(text.encode()))
    assert read_problem(tmp_path / "a.pomdp.gz").name == "a"
    monkeypatch.setattr(file_source, "LARGEST", 1 << 20)
    (tmp_path / "bomb.pomdp.gz").write_bytes(gzip.compress(b"#" * (3 << 20)))
    with pytest.raises(InputError, match=r"bomb.pomdp.gz: found more than 1048576 bytes"):
        read_problem(tmp_path / "bomb.pomdp.gz")
    (tmp_path / "cut.pomdp.gz").write_bytes(gzip.compress(text.encode())[:-9])
    with pytest.raises(InputError, match="not a readable gzip archive"):
        read_problem(tmp_path / "cut.pomdp.gz")


def test_comments_in_any_encoding_and_any_line_ends(tmp_path):
    (tmp_path / "a.pomdp").write_bytes(b"# caf\xe9\r" + (HEAD + EVEN).replace("\n", "\r").encode())
    assert read_problem(tmp_path / "a.pomdp").n_states == 2


# -- files of others -----------------------------------------------------------------------------------
SIZES = {
    "1d": (4, 2, 2, 0.75), "4x3.95": (11, 4, 6, 0.95), "aloha.10": (30, 9, 3, 0.999), "cheese.95": (11, 4, 7, 0.95),
    "ejs1": (3, 4, 2, 0.99999), "hallway": (60, 5, 21, 0.95), "network": (7, 4, 2, 0.95),
    "paint.95": (4, 4, 2, 0.95), "shuttle.95": (8, 3, 5, 0.95), "tag-avoid": (870, 5, 30, 0.95),
    "tiger.95": (2, 3, 2, 0.95), "tiger.aaai": (2, 3, 2, 0.75),
}  # fmt: skip


@pytest.mark.parametrize("name", SIZES)
def test_files_in_circulation(shared, name):
    problem = read_problem(shared / "data" / "pomdp" / f"{name}.pomdp")
    states, actions, observations, discount = SIZES[name]
    assert (problem.n_states, len(problem.choices[0]), len(problem.observations)) == (states, actions, observations)
    assert problem.discount == discount
    assert flat(problem).n_states == states


def test_numbers_in_files_in_circulation(shared):
    folder = shared / "data" / "pomdp"
    hallway = read_problem(folder / "hallway.pomdp")
    assert hallway.initial[0][0] == pytest.approx(0.017865, abs=1e-7)
    # Whatever enters one of the goals is worth 1.
    goal = hallway.choices[0][1].branches[0].transition.toarray()[:, 56:].sum(axis=1)
    np.testing.assert_allclose(hallway.choices[0][1].reward, goal, atol=1e-12)
    grid = read_problem(folder / "4x3.95.pomdp")
    assert set(grid.choices[0][0].reward) == {-0.04, 1.0, -1.0}
    ejs = read_problem(folder / "ejs1.pomdp")
    np.testing.assert_allclose(ejs.choices[0][0].reward[0], 0.81 + 0.18 * 0.5 + 0.01 * 0.25, atol=1e-14)


# -- what editors write --------------------------------------------------------------------------------
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("suffix", [".pomdp", ".pomdp.gz"])
def test_byte_order_marks(encoding, suffix, tmp_path):
    text = (HEAD + EVEN + "# ümläut\n").replace("\n", "\r\n")
    mark = "\ufeff" if encoding.endswith(("le", "be")) else ""
    content = (mark + text).encode(encoding)
    (tmp_path / f"a{suffix}").write_bytes(gzip.compress(content) if suffix.endswith("gz") else content)
    found = read_problem(tmp_path / f"a{suffix}")
    assert found.states == (("low", "high"),)
    assert found.discount == 0.9


def test_half_a_character_at_the_end_is_an_error_of_the_file(tmp_path):
    (tmp_path / "a.pomdp").write_bytes((HEAD + EVEN).encode("utf-16") + b"R")
    with pytest.raises(InputError, match=r"a\.pomdp, line 8: found "):
        read_problem(tmp_path / "a.pomdp")


def test_names_that_begin_with_an_underscore_or_any_letter():
    text = HEAD.replace("low high", "_low Höhe") + "T: * : _low : Höhe 1\nT: * : Höhe : _low 1\nO: * uniform\n"
    assert read(text).states == (("_low", "Höhe"),)


def test_the_last_word_on_all_rewards_leaves_nothing_of_earlier_ones():
    """To the last digit: nothing is averaged where every reward is the same."""
    text = HEAD.replace("low high", "a b c") + EVEN + "R: go : b : b : dark 10\nR: * : * : * : * -1"
    assert tables(read(text))[2].tolist() == [[-1, -1, -1], [-1, -1, -1]]
