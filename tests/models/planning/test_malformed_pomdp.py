"""Wrong `.pomdp` files: the message says where, what was found and what was wanted."""

import pytest

from models.errors import InputError
from models.planning.formats import read_problem

POMDP = """discount: 0.9
values: reward
states: low high
actions: wait go
observations: dark light
start: 0.5 0.5
T: wait identity
T: go uniform
O: * : low 0.8 0.2
O: * : high : dark 0.1
O: * : high : light 0.9
R: go : * : high : * 5
R: * : low : * : light -1
"""

WRONG_POMDP: dict[str, tuple[str | tuple[str, str], str]] = {
    "empty": (
        "",
        "line 1: found the end of the file without 'discount', wanted a statement",
    ),
    "no discount": (
        ("discount: 0.9\n", ""),
        "line 12: found the end of the file without 'discount', wanted a statemen",
    ),
    "discount above one": (
        ("0.9\n", "1.5\n"),
        "line 1: found 1.5, wanted a discount from 0 to 1",
    ),
    "discount no number": (
        ("0.9\n", "nan\n"),
        "line 1: found 'nan', wanted a number from 0 to 1 (discount)",
    ),
    "two discounts": (
        ("values: reward", "discount: 0.9"),
        "line 2: found 'discount', wanted one discount only",
    ),
    "values of what": (
        ("reward", "prices"),
        "line 2: found 'prices', wanted reward or cost",
    ),
    "unknown word": (
        ("values:", "valeurs:"),
        "line 2: found 'valeurs', wanted discount, values, states, actions, obser",
    ),
    "no states": (
        ("states: low high\n", "states:\n"),
        "line 3: found nothing, wanted the number or the names of the states",
    ),
    "same state twice": (
        ("low high", "low low"),
        "line 3: found 'low', wanted different names of states",
    ),
    "name begins with a digit": (
        ("dark light", "dark 2light"),
        "line 5: found '2light', wanted a name of one of the observations, which ",
    ),
    "negative number of states": (
        ("low high", "-3"),
        "line 3: found '-3', wanted a name of one of the states, which begins with a letter, or their number",
    ),
    "number of states with a sign": (
        ("low high", "+ 2"),
        "line 3: found '+', wanted a name of one of the states, which begins with a letter, or their number",
    ),
    "number of actions with a point": (
        ("wait go", "2.0"),
        "line 4: found '2.0', wanted a name of one of the actions, which begins with a letter, or their number",
    ),
    "name begins with a sign": (
        ("dark light", "dark -light"),
        "line 5: found '-light', wanted a name of one of the observations, which begins with a letter",
    ),
    "name begins with a bracket": (
        ("wait go", "(wait) go"),
        "line 4: found '(wait)', wanted a name of one of the actions, which begins with a letter",
    ),
    "same action twice": (
        ("wait go", "wait go wait"),
        "line 4: found 'wait', wanted different names of actions",
    ),
    "same observation twice": (
        ("dark light", "dark dark"),
        "line 5: found 'dark', wanted different names of observations",
    ),
    "start is no state": (
        ("start: 0.5 0.5", "start: mid"),
        "line 6: found 'mid', wanted uniform, a probability for each state, or one of the states: low, high",
    ),
    "number and names": (
        ("low high", "2 low high"),
        "line 3: found 'low', wanted a statement: states are given by their numbe",
    ),
    "too many states": (
        ("low high", "99999999"),
        "line 3: found 99999999, wanted from 1 to 1000000 states",
    ),
    "too long a number": (
        ("low high", "9" * 5000),
        "line 3: found '999999999999999",
    ),
    "statement before the states": (
        ("states: low high\n", ""),
        "line 5: found 'start', wanted 'states' before 'start'",
    ),
    "actions missing": (
        ("actions: wait go\n", ""),
        "line 6: found 'T', wanted 'actions' before the first T, O or R",
    ),
    "preamble too late": (
        ("T: go uniform", "values: cost"),
        "line 8: found 'values', wanted 'values' before the first T, O or R",
    ),
    "start too short": (
        ("start: 0.5 0.5", "start: 0.5 0.3 0.2"),
        "line 6: found 3 numbers, wanted 2: a probability for each state",
    ),
    "start does not add up": (
        ("start: 0.5 0.5", "start: 0.5 0.4"),
        "line 6: found a start distribution of sum 0.9, wanted a sum of 1 within ",
    ),
    "start is negative": (
        ("start: 0.5 0.5", "start: 1.5 -0.5"),
        "line 6: found -0.5, wanted probabilities from 0 to 1",
    ),
    "start in an unknown state": (
        ("start: 0.5 0.5", "start include: mid"),
        "line 6: found 'mid', wanted one of the states: low, high",
    ),
    "start nowhere": (
        ("start: 0.5 0.5", "start exclude: low high"),
        "line 6: found 2 of 2 states, wanted some states to exclude, not all",
    ),
    "start twice": (
        ("values: reward", "values: reward\nstates: 2"),
        "line 4: found 'states', wanted one statement on states only",
    ),
    "start after a reset": (
        ("start: 0.5 0.5\nT: wait identity", "T: wait reset\nstart: 1"),
        "line 7: found 'start', wanted 'start' before the first 'reset'",
    ),
    "unknown action": (
        ("T: go", "T: goo"),
        "line 8: found 'goo', wanted one of the actions: wait, go or *",
    ),
    "unknown state": (
        ("* : low 0.8", "* : lo 0.8"),
        "line 9: found 'lo', wanted one of the states: low, high or *",
    ),
    "unknown observation": (
        ("light 0.9", "bright 0.9"),
        "line 11: found 'bright', wanted one of the observations: dark, light or ",
    ),
    "number out of range": (
        ("T: go", "T: 2"),
        "line 8: found '2', wanted one of the actions: wait, go or *",
    ),
    "matrix too short": (
        ("T: go uniform", "T: go 1 0 1"),
        "line 8: found 3 numbers, wanted 4: a probability for each of the states,",
    ),
    "matrix too long": (
        ("T: go uniform", "T: go 1 0 1 0\n1"),
        "line 9: found 5 numbers, wanted 4: a probability for each of the states,",
    ),
    "row too long": (
        ("0.8 0.2", "0.8 0.2 0"),
        "line 9: found 3 numbers, wanted 2: a probability for each of the observa",
    ),
    "not a number in a matrix": (
        ("T: go uniform", "T: go 1 0 x 1"),
        "line 8: found 'x', wanted a number (a probability for each of the states",
    ),
    "probability above one": (
        ("dark 0.1", "dark 1.1"),
        "line 10: found 1.1, wanted a probability from 0 to 1",
    ),
    "negative in a matrix": (
        ("T: go uniform", "T: go 1 0 -1 2"),
        "line 8: found -1.0, wanted probabilities from 0 to 1",
    ),
    "infinite reward": (
        ("* 5", "* 1e999"),
        "line 12: found '1e999', wanted a reward",
    ),
    "row does not add up": (
        ("light 0.9", "light 0.8"),
        "line 11, O of action wait, end state high: found a sum of 0.9, wanted pr",
    ),
    "row left out": (
        ("T: go uniform", "T: go : low : low 1"),
        "line 13, T of action go, state high: found no entry up to here, wanted p",
    ),
    "identity of observations": (
        ("O: * : low 0.8 0.2", "O: * identity"),
        "line 9: found 'identity', wanted numbers or uniform for this matrix",
    ),
    "identity of a row": (
        ("T: go uniform", "T: go : low identity"),
        "line 8: found 'identity', wanted numbers or uniform for this row",
    ),
    "reset of observations": (
        ("O: * : low 0.8 0.2", "O: * reset"),
        "line 9: found 'reset', wanted numbers or uniform for this matrix",
    ),
    "colon missing": (
        ("T: go", "T go"),
        "line 8: found 'go', wanted ':' after T",
    ),
    "reward of an action alone": (
        ("R: go : * : high : * 5", "R: go 5"),
        "line 12: found '5', wanted ':' and a start state after the action",
    ),
    "reward row too short": (
        ("R: go : * : high : * 5", "R: go : * : high 5"),
        "line 12: found 1 number, wanted 2: a reward for each observation",
    ),
    "ends in the middle": (
        ("R: * : low : * : light -1\n", "R: * : low :"),
        "line 13: found the end of the file, wanted one of the states",
    ),
    "sign alone": (
        ("light -1", "light -"),
        "line 13: found the end of the file, wanted a reward",
    ),
    "unprintable name": (
        ("dark light", "dark li\x07ght"),
        "line 5: found 'li\\x07ght', wanted a name of one of the observations, whi",
    ),
}


def changed(text, change):
    if isinstance(change, str):
        return change
    old, new = change
    assert old in text
    return text.replace(old, new, 1)


def test_what_they_are_made_from_is_right(tmp_path):
    (tmp_path / "a.pomdp").write_text(POMDP)
    assert read_problem(tmp_path / "a.pomdp").n_states == 2


@pytest.mark.parametrize("name", WRONG_POMDP)
def test_wrong_pomdp(name, tmp_path):
    change, wanted = WRONG_POMDP[name]
    path = tmp_path / "wrong.pomdp"
    path.write_text(changed(POMDP, change))
    with pytest.raises(InputError) as error:
        read_problem(path)
    assert str(error.value).startswith(f"{path}, {wanted}")
