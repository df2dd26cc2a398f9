"""The mutator itself: which changes it makes, that they take effect, and that a test which looks notices them."""

import json
import os
import subprocess
import sys

import pytest

from tests.mutation.__main__ import CHECKOUT, EXPLAINED, explanations
from tests.mutation.operators import mutants
from tests.mutation.suites import SUITES

SOURCE = '''
"""A module."""

LEFT_ALONE = 3


class Box:
    def half(self, x: int = 4) -> float:
        """Untouched."""
        return x / 2


def total(values, skip):
    out = 0.0
    for i in range(len(values)):
        if i == skip or values[i] < 0.0:
            continue
        out += max(values[i], 1)
    return out, skip
'''


def changed(function, after):
    """The function as the mutant with that statement has it."""
    mutant = next(m for m in mutants(SOURCE) if m.function == function and m.after == after)
    space = {}
    exec(compile(SOURCE, "x.py", "exec"), space)
    found = space["Box"].half if function == "Box.half" else space[function]
    found.__code__ = mutant.codes("x.py")[function]
    return found


def test_every_kind_of_change_is_made_where_it_applies():
    found = {(m.function, m.operator, m.after) for m in mutants(SOURCE)}
    assert found == {
        ("Box.half", "arithmetic", "return x * 2"),
        ("Box.half", "constant", "return x / 3"),
        ("Box.half", "constant", "return x / 1"),
        ("total", "constant", "out = 1.0"),
        ("total", "range", "for i in range(0 + 1, len(values)):"),
        ("total", "range", "for i in range(0, len(values) - 1):"),
        ("total", "logic", "if i == skip and values[i] < 0.0:"),
        ("total", "logic", "if values[i] < 0.0:"),
        ("total", "logic", "if i == skip:"),
        ("total", "comparison", "if i != skip or values[i] < 0.0:"),
        ("total", "boundary", "if i == skip or values[i] <= 0.0:"),
        ("total", "comparison", "if i == skip or values[i] >= 0.0:"),
        ("total", "index", "if i == skip or values[i - 1] < 0.0:"),
        ("total", "constant", "if i == skip or values[i] < 1.0:"),
        ("total", "delete", "pass"),
        ("total", "arithmetic", "out -= max(values[i], 1)"),
        ("total", "accumulate", "out = max(values[i], 1)"),
        ("total", "exchange", "out += min(values[i], 1)"),
        ("total", "bound", "out += values[i]"),
        ("total", "bound", "out += 1"),
        ("total", "index", "out += max(values[i - 1], 1)"),
        ("total", "constant", "out += max(values[i], 2)"),
        ("total", "constant", "out += max(values[i], 0)"),
        ("total", "exchange", "return (skip, out)"),
    }
    assert [m.number for m in mutants(SOURCE)] == list(range(len(mutants(SOURCE))))


def test_a_mutant_does_what_it_says():
    assert changed("Box.half", "return x * 2")(None, 5) == 10
    assert changed("total", "out += min(values[i], 1)")([3.0, 0.5, 7.0], 2) == (1.5, 2)
    assert changed("total", "out = max(values[i], 1)")([3.0, 0.5, 7.0], 5) == (7.0, 5)
    assert changed("total", "return (skip, out)")([3.0], 5) == (5, 3.0)


def test_every_file_has_tests_that_exist_and_every_explanation_its_mutant():
    import tomllib

    for file, tests in SUITES.items():
        assert (CHECKOUT / file).is_file()
        assert tests
        assert all((CHECKOUT / test).is_file() for test in tests)
    for file in tomllib.loads(EXPLAINED.read_text(encoding="utf-8")):
        known = {(m.function, m.before, m.after) for m in mutants((CHECKOUT / file).read_text(encoding="utf-8"))}
        assert not set(explanations(file)) - known


@pytest.mark.slow
def test_a_kernel_that_is_changed_is_noticed(tmp_path):
    out = tmp_path / "verdicts.json"
    ran = subprocess.run(
        [sys.executable, "-m", "tests.mutation", "models/planning/step_kernel.py", "--function", "expected_reward",
         "--out", str(out)],
        cwd=CHECKOUT, capture_output=True, text=True, check=False, env={**os.environ, "NUMBA_DISABLE_JIT": "0"},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout + ran.stderr
    verdicts = json.loads(out.read_text(encoding="utf-8"))["models/planning/step_kernel.py"]
    assert len(verdicts) > 5
    assert {v["outcome"] for v in verdicts} == {"killed"}
