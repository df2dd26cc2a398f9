"""The `.pomdpx` format: tables against dense ones, diagrams against tables, factors against their product."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.planning.formats import read_problem
from models.planning.formats.end_state import flat
from models.planning.formats.pomdpx_table import Axis, read_function
from models.planning.formats.pomdpx_xml import read_tree
from tests.models.planning.test_malformed_pomdpx import POMDPX, changed
from tests.reference.planning import horizon_value


def read(folder, text, name="a.pomdpx"):
    (folder / name).write_text(text, encoding="utf-8")
    return read_problem(folder / name)


def dense(problem):
    """Joint tables of a problem over (mode, hidden), ``[a, s, s', o]`` and ``[a, s]``."""
    problem = flat(problem, hide_start=True)
    choices = problem.choices[0]
    joint = np.stack([
        c.branches[0].transition.toarray()[:, :, None] * c.branches[0].emission.toarray() for c in choices
    ])  # fmt: skip
    return joint, np.stack([c.reward for c in choices]), problem.initial[0]


def assert_same(one, other):
    for a, b in zip(dense(one), dense(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)


# -- a small file, number by number --------------------------------------------------------------------
def test_a_small_file(tmp_path):
    problem = read(tmp_path, POMDPX)
    assert problem.modes == ("left", "right")
    assert problem.states == (("s0", "s1"), ("s0", "s1"))
    assert problem.observations == ("dark", "light")
    assert [c.action for c in problem.choices[0]] == ["wait", "go"]
    wait, go = problem.choices[0]
    assert [b.mode for b in wait.branches] == [0]
    assert [b.mode for b in go.branches] == [1]
    assert wait.branches[0].transition.toarray().tolist() == [[1, 0], [0, 1]]
    assert go.branches[0].transition.toarray().tolist() == [[0.5, 0.5], [0.5, 0.5]]
    assert go.branches[0].emission.toarray().tolist() == [[0.8, 0.2], [0.1, 0.9]]
    assert go.reward.tolist() == [0, 5]
    assert [b.tolist() for b in problem.initial] == [[0.5, 0.5], [0, 0]]
    assert horizon_value(problem, 1) == 2.5


def test_an_encoding_of_its_own(tmp_path):
    text = POMDPX.replace("UTF-8", "ISO-8859-1").replace("dark", "d\xfcster")
    (tmp_path / "a.pomdpx").write_bytes(text.encode("latin-1"))
    assert read_problem(tmp_path / "a.pomdpx").observations == ("d\xfcster", "light")


def test_parts_in_any_order(tmp_path):
    start, end = POMDPX.index("<InitialStateBelief>"), POMDPX.index("<StateTransitionFunction>")
    moved = POMDPX[:start] + POMDPX[end:].replace("</pomdpx>", POMDPX[start:end] + "</pomdpx>")
    assert_same(read(tmp_path, moved), read(tmp_path, POMDPX, "b.pomdpx"))


# -- shorthands ----------------------------------------------------------------------------------------
TABLE = '<Parameter type="TBL">\n<Entry><Instance>s0 -</Instance><ProbTable>0.8 0.2</ProbTable></Entry>\n<Entry>'
TABLE += "<Instance>s1 -</Instance><ProbTable>0.1 0.9</ProbTable></Entry>\n</Parameter>"


@pytest.mark.parametrize(
    "entries",
    [
        [("- -", "0.8 0.2 0.1 0.9")],
        [("* -", "0.1 0.9"), ("s0 dark", "0.8"), ("s0 light", "0.2")],
        [("* -", "uniform"), ("s1 *", "0"), ("s1 -", "0.1 0.9"), ("- dark", "0.8 0.1"), ("0 1", "0.2")],
        [("- -", "identity"), ("s0 -", ".8 2e-1"), ("s1 dark", "1.0e-1"), ("s1 light", "0.9")],
        [("* *", "0.1"), ("s0 dark", "0.8"), ("s0 light", "0.2"), ("s1 light", "0.9")],
    ],
)
def test_ways_to_write_a_table(entries, tmp_path):
    body = "".join(f"<Entry><Instance> {i}\n</Instance><ProbTable>{v}</ProbTable></Entry>" for i, v in entries)
    text = changed(POMDPX, (TABLE, f"<Parameter>{body}</Parameter>"))
    assert_same(read(tmp_path, text), read(tmp_path, POMDPX, "b.pomdpx"))


DIAGRAM = """<Parameter type="DD"><DAG><Node var="mood_1">
<Edge val="s0"><Node var="look"><Edge val="dark"><Terminal>0.8</Terminal></Edge>
<Edge val="light"><Terminal> .2 </Terminal></Edge></Node></Edge>
<Edge val="s1"><SubDAG type="template" idref="rest"/></Edge>
</Node></DAG><SubDAGTemplate id="rest"><Node var="look">
<Edge val="light"><Terminal>0.9</Terminal></Edge><Edge val="dark"><Terminal>0.1</Terminal></Edge>
</Node></SubDAGTemplate></Parameter>"""


def test_a_diagram_for_the_same_table(tmp_path):
    assert_same(read(tmp_path, changed(POMDPX, (TABLE, DIAGRAM))), read(tmp_path, POMDPX, "b.pomdpx"))


def test_shorthands_of_diagrams(tmp_path):
    old = POMDPX[POMDPX.index('<Edge val="wait"') : POMDPX.index("</Node></DAG>")]
    new = (
        '<Edge val="wait"><Node var="mood_0"><Edge val="s0"><SubDAG type="persistent" var="mood_1"/></Edge>'
        '<Edge val="s1"><SubDAG type="deterministic" var="mood_1" val="s0"/></Edge></Node></Edge>'
        '<Edge val="go"><SubDAG type="uniform" var="mood_1"/></Edge>'
    )
    wait, go = read(tmp_path, changed(POMDPX, (old, new))).choices[0]
    assert wait.branches[0].transition.toarray().tolist() == [[1, 0], [1, 0]]
    assert go.branches[0].transition.toarray().tolist() == [[0.5, 0.5], [0.5, 0.5]]


JOINT = """<InitialStateBelief><CondProb><Var>mood_0 place_0</Var><Parent>null</Parent>
<Parameter type="DD"><DAG><Node var="place_0"><Edge val="right"><Terminal>0</Terminal></Edge>
<Edge val="left"><SubDAG type="uniform" var="mood_0"/></Edge></Node></DAG></Parameter></CondProb>
</InitialStateBelief>
"""


def test_a_joint_start_in_one_function(tmp_path):
    start = POMDPX[POMDPX.index("<InitialStateBelief>") : POMDPX.index("<StateTransitionFunction>")]
    assert_same(read(tmp_path, changed(POMDPX, (start, JOINT))), read(tmp_path, POMDPX, "b.pomdpx"))


def test_hidden_start_that_depends_on_what_is_seen(tmp_path):
    old = "<Parent>null</Parent><Parameter>\n<Entry><Instance>-</Instance><ProbTable>uniform"
    new = "<Parent>place_0</Parent><Parameter>\n<Entry><Instance>- -</Instance><ProbTable>.9 .1 .3 .7"
    text = changed(changed(POMDPX, (old, new)), ("1.0 0.0", "0.25 0.75"))
    initial = read(tmp_path, text).initial
    np.testing.assert_allclose(np.stack(initial), [[0.225, 0.025], [0.225, 0.525]], rtol=1e-15)


# -- rewards -------------------------------------------------------------------------------------------
def test_rewards_add_up_and_are_averaged_over_the_end(tmp_path):
    more = (
        "<Func><Var>extra</Var><Parent>act place_0 mood_1 look</Parent><Parameter>"
        "<Entry><Instance>go * s1 light</Instance><ValueTable>10</ValueTable></Entry>"
        "<Entry><Instance>wait left - dark</Instance><ValueTable>1 -2</ValueTable></Entry></Parameter></Func>"
        "<Func><Var>third</Var><Parent>place_1</Parent><Parameter><Entry><Instance>right</Instance><ValueTable>0.5"
        "</ValueTable></Entry></Parameter></Func></RewardFunction>"
    )
    text = changed(POMDPX, ('<RewardVar vname="gain"/>', "".join(
        f'<RewardVar vname="{n}"/>' for n in ("gain", "extra", "third")
    )))  # fmt: skip
    problem = read(tmp_path, changed(text, ("</RewardFunction>", more)))
    wait, go = problem.choices[0]
    np.testing.assert_allclose(wait.reward, [0.8 * 1, 0.1 * -2], atol=1e-15)
    np.testing.assert_allclose(go.reward, [0.5 * 0.9 * 10 + 0.5, 5 + 0.5 * 0.9 * 10 + 0.5], atol=1e-15)


# -- factors -------------------------------------------------------------------------------------------
def test_factors_multiply(tmp_path):
    """Two hidden variables, one of which follows the other's end, two observations, two action variables."""
    rng = np.random.default_rng(5)
    first, second, third = (rng.dirichlet(np.ones(2), size) for size in ((2, 2), (2, 2), (2, 2)))
    looks = rng.dirichlet(np.ones(3), (2, 2))

    def numbers(table):
        return " ".join(repr(float(v)) for v in table.ravel())

    def function(var, parents, table):
        spots = " ".join("-" for _ in range(table.ndim))
        return (
            f"<CondProb><Var>{var}</Var><Parent>{parents}</Parent><Parameter><Entry><Instance>{spots}</Instance>"
            f"<ProbTable>{numbers(table)}</ProbTable></Entry></Parameter></CondProb>"
        )

    def variable(tag, names, count):
        return f"<{tag} {names}><NumValues>{count}</NumValues></{tag}>"

    text = (
        "<pomdpx><Discount>0.5</Discount><Variable>"
        + variable("StateVar", 'vnamePrev="u" vnameCurr="v"', 2)
        + variable("StateVar", 'vnamePrev="p" vnameCurr="q"', 2)
        + variable("ObsVar", 'vname="l"', 3) + variable("ObsVar", 'vname="m"', 2)
        + variable("ActionVar", 'vname="a"', 2) + variable("ActionVar", 'vname="b"', 2) + '<RewardVar vname="r"/>'
        + "</Variable><InitialStateBelief>" + function("u", "null", np.array([0.3, 0.7]))
        + function("p", "u", np.array([[0.1, 0.9], [0.5, 0.5]])) + "</InitialStateBelief><StateTransitionFunction>"
        + function("q", "b v", second) + function("v", "u a", first) + "</StateTransitionFunction><ObsFunction>"
        + function("l", "a q", looks) + function("m", "v q", third)
        + "</ObsFunction><RewardFunction><Func><Var>r</Var><Parent>a u p</Parent><Parameter><Entry>"
        + "<Instance>a1 s1 *</Instance><ValueTable>1</ValueTable></Entry></Parameter></Func>"
        + "</RewardFunction></pomdpx>"
    )  # fmt: skip
    problem = read(tmp_path, text)
    assert [c.action for c in problem.choices[0]] == ["a0,a0", "a0,a1", "a1,a0", "a1,a1"]
    assert problem.states[0] == ("s0,s0", "s0,s1", "s1,s0", "s1,s1")
    np.testing.assert_allclose(problem.initial[0], [0.03, 0.27, 0.35, 0.35], atol=1e-15)
    joint, reward, _ = dense(problem)
    for a, b, u, p, v, q, m, sees in product(*[range(2)] * 7, range(3)):
        wanted = first[u, a, v] * second[b, v, q] * looks[a, q, sees] * third[v, q, m]
        assert joint[2 * a + b, 2 * u + p, 2 * v + q, 2 * sees + m] == pytest.approx(wanted, abs=1e-15)
        assert reward[2 * a + b, 2 * u + p] == a * u


@st.composite
def functions(draw):
    """A function written entry by entry, and its dense table filled by assignment."""
    sizes = draw(st.lists(st.integers(1, 3), min_size=1, max_size=4))
    table, entries = np.zeros(sizes), []
    for _ in range(draw(st.integers(0, 8))):
        words = [draw(st.sampled_from(["*", "-", *map(str, range(n))])) for n in sizes]
        where = tuple(slice(None) if w in "*-" else slice(int(w), int(w) + 1) for w in words)
        cycled = [n for w, n in zip(words, sizes, strict=True) if w == "-"]
        count = int(np.prod(cycled))
        values = draw(st.lists(st.sampled_from([0.0, 0.5, 1.0]), min_size=count, max_size=count))
        shape = [n if w == "-" else 1 for w, n in zip(words, sizes, strict=True)]
        table[where] = np.reshape(values, shape)
        entries.append((" ".join(words), " ".join(map(str, values))))
    return sizes, draw(st.integers(0, len(sizes) - 1)), table, entries


@given(functions())
def test_any_table_is_that_of_a_dense_reading(tmp_path_factory, case):
    sizes, n_parents, wanted, entries = case
    path = tmp_path_factory.getbasetemp() / "table.xml"
    body = "".join(f"<Entry><Instance>{i}</Instance><ProbTable>{v}</ProbTable></Entry>" for i, v in entries)
    path.write_text(f"<CondProb><Var/><Parent/><Parameter>{body}</Parameter></CondProb>")
    axes = [Axis(f"x{i}", tuple(f"v{j}" for j in range(n))) for i, n in enumerate(sizes)]
    function = read_function(read_tree(path), axes[:n_parents], axes[n_parents:], probabilities=True)
    np.testing.assert_array_equal(function.table.matrix().toarray().reshape(sizes), wanted)
