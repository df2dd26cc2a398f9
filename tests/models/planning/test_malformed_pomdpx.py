"""Wrong `.pomdpx` files: the message says where, what was found and what was wanted."""

import pytest

from models.errors import InputError
from models.planning.formats import pomdpx_table, read_problem
from models.planning.formats.pomdpx_xml import read_tree
from tests.models.planning.test_malformed_pomdp import changed

POMDPX = """<?xml version="1.0" encoding="UTF-8"?>
<pomdpx version="1.0" id="small">
<Discount>0.9</Discount>
<Variable>
<StateVar vnamePrev="place_0" vnameCurr="place_1" fullyObs="true"><ValueEnum>left right</ValueEnum></StateVar>
<StateVar vnamePrev="mood_0" vnameCurr="mood_1"><NumValues>2</NumValues></StateVar>
<ObsVar vname="look"><ValueEnum>dark light</ValueEnum></ObsVar>
<ActionVar vname="act"><ValueEnum>wait go</ValueEnum></ActionVar>
<RewardVar vname="gain"/>
</Variable>
<InitialStateBelief>
<CondProb><Var>place_0</Var><Parent>null</Parent><Parameter type="TBL">
<Entry><Instance>-</Instance><ProbTable>1.0 0.0</ProbTable></Entry>
</Parameter></CondProb>
<CondProb><Var>mood_0</Var><Parent>null</Parent><Parameter>
<Entry><Instance>-</Instance><ProbTable>uniform</ProbTable></Entry>
</Parameter></CondProb>
</InitialStateBelief>
<StateTransitionFunction>
<CondProb><Var>place_1</Var><Parent>act place_0</Parent><Parameter type="TBL">
<Entry><Instance>wait - -</Instance><ProbTable>identity</ProbTable></Entry>
<Entry><Instance>go - -</Instance><ProbTable>0 1 1 0</ProbTable></Entry>
</Parameter></CondProb>
<CondProb><Var>mood_1</Var><Parent>act mood_0</Parent><Parameter type="DD"><DAG><Node var="act">
<Edge val="wait"><SubDAG type="persistent" var="mood_1"/></Edge>
<Edge val="go"><SubDAG type="template" idref="t"/></Edge>
</Node></DAG><SubDAGTemplate id="t"><SubDAG type="uniform" var="mood_1"/></SubDAGTemplate></Parameter></CondProb>
</StateTransitionFunction>
<ObsFunction>
<CondProb><Var>look</Var><Parent>mood_1</Parent><Parameter type="TBL">
<Entry><Instance>s0 -</Instance><ProbTable>0.8 0.2</ProbTable></Entry>
<Entry><Instance>s1 -</Instance><ProbTable>0.1 0.9</ProbTable></Entry>
</Parameter></CondProb>
</ObsFunction>
<RewardFunction>
<Func><Var>gain</Var><Parent>act mood_0</Parent><Parameter type="TBL">
<Entry><Instance>go s1</Instance><ValueTable>5</ValueTable></Entry>
</Parameter></Func>
</RewardFunction>
</pomdpx>
"""

WRONG_POMDPX: dict[str, tuple[str | tuple[str, str], str]] = {
    "empty": (
        "",
        "line 1, column 1: not valid XML: no element found",
    ),
    "not closed": (
        ("</Variable>", ""),
        "line 40, column 3: not valid XML: mismatched tag",
    ),
    "another root": (
        ("<pomdpx version", "<pomdp version"),
        "line 40, column 3: not valid XML: mismatched tag",
    ),
    "document type": (
        ("<pomdpx", "<!DOCTYPE a>\n<pomdpx"),
        "line 2: found a document type or an entity, wanted plain elements: <!DOC",
    ),
    "entities": (
        ("<pomdpx", '<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;&b;">]><pomdpx'),
        "line 2: found a document type or an entity, wanted plain elements: <!DOC",
    ),
    "unknown encoding": (
        ("UTF-8", "UTF-12"),
        "line 1: not valid XML: unknown encoding: UTF-12",
    ),
    "too deep": (
        ("<Discount>0.9</Discount>", "<a>" * 600 + "</a>" * 600),
        "line 3: found deeper nesting, wanted at most 500",
    ),
    "unknown element": (
        ("<Discount>", "<Price>1</Price><Discount>"),
        "line 3, <Price>: found '<Price>', wanted <Description> or <Discount> or ",
    ),
    "no discount": (
        ("<Discount>0.9</Discount>", ""),
        "line 2, <pomdpx>: found 0 <Discount> in <pomdpx>, wanted exactly one",
    ),
    "two discounts": (
        ("<Discount>", "<Discount>1</Discount><Discount>"),
        "line 3, <Discount>: found 2 <Discount> in <pomdpx>, wanted exactly one",
    ),
    "discount no number": (
        (">0.9<", ">0,9<"),
        "line 3, <Discount>: found '0,9', wanted a number: the discount",
    ),
    "discount above one": (
        (">0.9<", ">1.9<"),
        "line 3, <Discount>: found 1.9, wanted a discount from 0 to 1",
    ),
    "no action": (
        ('<ActionVar vname="act"><ValueEnum>wait go</ValueEnum></ActionVar>', ""),
        "line 4, <Variable>: found no <ActionVar>, wanted at least one",
    ),
    "name missing": (
        ('vname="look"', 'name="look"'),
        'line 7, <ObsVar>: found no attribute vname, wanted vname="..."',
    ),
    "name twice": (
        ('vname="look"', 'vname="act"'),
        "line 8, <ActionVar>: found 'act', wanted a name for vname of one word th",
    ),
    "neither true nor false": (
        ('fullyObs="true"', 'fullyObs="yes"'),
        'line 5, <StateVar>: found \'yes\', wanted fullyObs="true" or "false"',
    ),
    "no values": (
        ("<ValueEnum>dark light</ValueEnum>", ""),
        "line 7, <ObsVar>: found 0 lists of values, wanted one <ValueEnum> or <Nu",
    ),
    "same value twice": (
        ("dark light", "dark dark"),
        "line 7, <ValueEnum>: found 'dark dark', wanted different names, none of ",
    ),
    "too many values": (
        (">2<", ">2000000<"),
        "line 6, <NumValues>: found '2000000', wanted a number from 1 to 1000000",
    ),
    "too many states": (
        (">2<", ">900000<"),
        "line 27: found 810000900000 entries that are not zero, wanted at most 30",
    ),
    "function of an unknown variable": (
        ("<Var>place_0", "<Var>place_2"),
        "line 12, <Var>: found 'place_2', wanted one of place_0, mood_0",
    ),
    "unknown parent": (
        ("act place_0", "act spot_0"),
        "line 20, <Parent>: found 'spot_0', wanted one of act, place_0, mood_0, p",
    ),
    "observation of the start": (
        ("<Parent>mood_1", "<Parent>mood_0"),
        "line 30, <Parent>: found 'mood_0', wanted one of act, place_1, mood_1, l",
    ),
    "instance too short": (
        ("wait - -", "wait -"),
        "line 21, <Instance>: found 2 values, wanted 3: one for each of act place",
    ),
    "unknown value": (
        ("wait - -", "sit - -"),
        "line 21, <Instance>: found 'sit', wanted a value of act: wait, go",
    ),
    "value out of range": (
        ("wait - -", "2 - -"),
        "line 21, <Instance>: found '2', wanted a value of act: wait, go",
    ),
    "too few numbers": (
        ("0 1 1 0", "0 1 1"),
        "line 22, <ProbTable>: found 3 numbers, wanted 4, one for each combinatio",
    ),
    "no number": (
        ("0 1 1 0", "0 1 1 inf"),
        "line 22, <ProbTable>: found 'inf', wanted a number",
    ),
    "probability above one": (
        ("0 1 1 0", "0 1 1 2"),
        "line 22, <ProbTable>: found 2.0, wanted probabilities from 0 to 1",
    ),
    "identity of one axis": (
        ("wait - -", "wait * -"),
        "line 21, <ProbTable>: found identity over 2, wanted two '-' of the same ",
    ),
    "uniform at one value": (
        ("<Instance>-</Instance><ProbTable>uniform", "<Instance>s0</Instance><ProbTable>uniform"),
        "line 16, <ProbTable>: found 'uniform', wanted numbers, as the variable's",
    ),
    "no table": (
        ("<ProbTable>uniform</ProbTable>", ""),
        "line 16, <Entry>: found 0 <ProbTable> in <Entry>, wanted exactly one",
    ),
    "row does not add up": (
        ("0.1 0.9", "0.1 0.8"),
        "line 32, look given mood_1 s1: found a sum of 0.9, wanted probabilities ",
    ),
    "row left out": (
        ("<Entry><Instance>s1 -</Instance><ProbTable>0.1 0.9</ProbTable></Entry>\n", ""),
        "line 31, look given mood_1 s1: found no entry up to here, wanted probabi",
    ),
    "nothing about a variable": (
        ("<CondProb><Var>mood_0</Var>", "<CondProb><Var>place_0</Var>"),
        "line 15, <Var>: found 'place_0', wanted variables that no other element ",
    ),
    "nothing about the mood": (
        ("<Var>mood_1</Var><Parent>act mood_0<", "<Var>place_1</Var><Parent>act mood_0<"),
        "line 24, <Var>: found 'place_1', wanted variables that no other element ",
    ),
    "unknown type": (
        ('type="DD"', 'type="CONT"'),
        "line 24, <Parameter>: found 'CONT', wanted type TBL or DD",
    ),
    "test of a stranger": (
        ('<Node var="act">', '<Node var="look">'),
        "line 24, <Node>: found 'look', wanted one of act, mood_0, mood_1",
    ),
    "edge twice": (
        ('<Edge val="go">', '<Edge val="wait">'),
        "line 26, <Edge>: found 'wait', wanted one edge for each value",
    ),
    "no such template": (
        ('idref="t"', 'idref="u"'),
        "line 26, <SubDAG>: found 'u', wanted a template: t",
    ),
    "template in itself": (
        ('<SubDAG type="uniform" var="mood_1"/>', '<SubDAG type="template" idref="t"/>'),
        "line 27, <SubDAG>: found 't', wanted templates that do not contain thems",
    ),
    "unknown shorthand": (
        ('type="persistent"', 'type="stable"'),
        "line 25, <SubDAG>: found 'stable', wanted deterministic, persistent, uni",
    ),
    "persistence of a start": (
        ('"persistent" var="mood_1"', '"persistent" var="mood_0"'),
        "line 25, <SubDAG>: found 'mood_0', wanted the end of a step whose start ",
    ),
    "empty edge": (
        ('<SubDAG type="persistent" var="mood_1"/>', ""),
        "line 25, <Edge>: found 0 elements, wanted one <Node>, <SubDAG> or <Termi",
    ),
    "parent of itself": (
        ("<Var>place_1</Var><Parent>act place_0", "<Var>place_1</Var><Parent>act place_1"),
        "line 20, <Parent>: found 'place_1', wanted a parent that is not the vari",
    ),
    "function without a name": (
        ("<Func><Var>gain</Var>", "<Func>"),
        "line 36, <Func>: found 0 <Var> in <Func>, wanted exactly one",
    ),
    "reward of nobody": (
        ("<Var>gain", "<Var>loss"),
        "line 36, <Var>: found 'loss', wanted one of gain",
    ),
    "reward that is none": (
        (">5<", ">5 6<"),
        "line 37, <ValueTable>: found 2 numbers, wanted 1, one for each combinati",
    ),
}


def test_what_they_are_made_from_is_right(tmp_path):
    (tmp_path / "a.pomdpx").write_text(POMDPX)
    assert read_problem(tmp_path / "a.pomdpx").n_modes == 2


@pytest.mark.parametrize("name", WRONG_POMDPX)
def test_wrong_pomdpx(name, tmp_path):
    change, wanted = WRONG_POMDPX[name]
    path = tmp_path / "wrong.pomdpx"
    path.write_text(changed(POMDPX, change))
    with pytest.raises(InputError) as error:
        read_problem(path)
    assert str(error.value).startswith(f"{path}, {wanted}")


def test_a_circle_of_two(tmp_path):
    path = tmp_path / "wrong.pomdpx"
    text = changed(POMDPX, ("act place_0", "act mood_1"))
    path.write_text(changed(text, ("act mood_0</Parent><Parameter t", "act mood_0 place_1</Parent><Parameter t")))
    with pytest.raises(InputError, match=r"line 20: found a circle among place_1, mood_1, wanted parents"):
        read_problem(path)


def test_a_short_diagram_of_very_many_paths_is_refused(tmp_path, monkeypatch):
    """Each template tests one variable and uses the next one twice: 2^20 paths in 22 lines."""
    monkeypatch.setattr(pomdpx_table, "MOST_PATHS", 10_000)
    templates = "".join(
        f'<SubDAGTemplate id="t{i}"><Node var="x{i}">'
        + "".join(f'<Edge val="{v}"><SubDAG type="template" idref="t{i + 1}"/></Edge>' for v in range(2))
        + "</Node></SubDAGTemplate>\n"
        for i in range(20)
    )
    dag = '<DAG><SubDAG type="template" idref="t0"/></DAG>'
    last = '<SubDAGTemplate id="t20"><Terminal>1</Terminal></SubDAGTemplate>'
    path = tmp_path / "many.pomdpx"
    path.write_text(f'<Func><Parameter type="DD">{dag}\n{templates}{last}</Parameter></Func>')
    axes = [pomdpx_table.Axis(f"x{i}", ("no", "yes")) for i in range(20)]
    with pytest.raises(
        InputError, match=r"line \d+, <\w+>: found more paths, wanted a diagram of at most 10000 paths"
    ):
        pomdpx_table.read_function(read_tree(path), axes, [], probabilities=False)


def test_a_variable_tested_again_takes_the_same_way(tmp_path):
    """Templates that test one variable over and over: its value is settled at the first test."""
    chain = "".join(
        f'<SubDAGTemplate id="t{i}"><Node var="act">'
        + "".join(f'<Edge val="{v}"><SubDAG type="template" idref="t{i + 1}"/></Edge>' for v in ("wait", "go"))
        + "</Node></SubDAGTemplate>"
        for i in range(1, 60)
    )
    text = changed(POMDPX, ('idref="t"', 'idref="t1"'))
    path = tmp_path / "a.pomdpx"
    path.write_text(changed(text, ('<SubDAGTemplate id="t">', chain + '<SubDAGTemplate id="t60">')))
    assert read_problem(path).n_modes == 2
