"""The parameter vector: layout, pins, priors, and what a design can inform."""

import numpy as np
import pytest

from models.errors import InputError
from models.events import EventLog
from models.parameters import DirichletPrior, Layout, checked_pins, recorded
from models.protocol import PUBLISHED
from tests.models.test_protocol import THREE
from tests.models.test_simulation import design_of
from tests.random_cases import random_tables


@pytest.mark.parametrize("protocol", [PUBLISHED, THREE])
def test_pack_and_unpack_and_rows(protocol):
    tables = random_tables(np.random.default_rng(1), protocol, 3)
    layout = Layout(protocol, 3)
    theta = layout.pack(*tables)
    assert theta.shape == (layout.size,)
    for table, twin in zip(layout.unpack(theta), tables, strict=True):
        assert np.array_equal(table, twin)
    by_row = [row for table in tables for row in table.reshape(-1, table.shape[-1])]
    assert len(layout.rows) == len(by_row)
    for row, values in zip(layout.rows, by_row, strict=True):
        assert np.array_equal(theta[row], values)
    assert all(layout.uniform[row].sum() == pytest.approx(1) for row in layout.rows)
    assert all(np.ptp(layout.uniform[row]) == 0 for row in layout.rows)


def test_pins_free_everything_else():
    layout = Layout(PUBLISHED, 2)
    pins = checked_pins(layout, {"help": None, "signal": np.array([[0.9, 0.1], [0.2, 0.8]])})
    assert np.array_equal(pins["help"], np.eye(2))
    initial, transition, emission = layout.unpack(layout.free_entries(pins))
    assert initial.all()
    assert emission.all()
    assert transition[[0, 2]].all()
    assert not transition[[1, 3]].any()


@pytest.mark.parametrize(
    ("pins", "message"),
    [
        ({"wave": None}, "action: found 'wave'"),
        ({"help": np.eye(3)}, r"pinned table of help, shape: found \(3, 3\), wanted \(2, 2\)"),
        ({"help": [[1, 0], [0.5, 0.4]]}, "pinned, action help, state 1, sum of the row: found '0.9', wanted 1"),
    ],
)
def test_unusable_pins_are_refused(pins, message):
    with pytest.raises(InputError, match=message):
        checked_pins(Layout(PUBLISHED, 2), pins)


def test_pseudo_counts_are_dirichlet_parameters_minus_one():
    layout = Layout(PUBLISHED, 2)
    assert not DirichletPrior().pseudo_counts(layout).any()
    prior = DirichletPrior(initial=2.0, transition=1.5, emission=3.0, stay=4.0)
    initial, transition, emission = layout.unpack(prior.pseudo_counts(layout))
    assert np.all(initial == 1)
    assert np.all(transition == [[4.5, 0.5], [0.5, 4.5]])
    assert np.all(emission == 2)


@pytest.mark.parametrize(
    ("name", "value"), [("initial", 0.9), ("transition", 0.0), ("emission", np.inf), ("stay", -0.1)]
)
def test_priors_without_a_mode_are_refused(name, value):
    with pytest.raises(InputError, match=f"prior, {name}: found {value}, wanted a number of at least"):
        DirichletPrior(**{name: value})


def test_what_a_design_can_inform():
    """`help` only ever comes last: no evidence on its transition table. `signal` is always missing."""
    log = design_of([[(0, -1), (2, 1), (1, -1)], [(3, -1), (2, 0)], [(1, -1)]])
    layout = Layout(PUBLISHED, 2)
    entries = layout.informed_entries(log)
    initial, transition, emission = layout.unpack(entries)
    assert initial.all()
    assert [t.all() for t in transition] == [True, False, True, True]
    assert [t.any() for t in transition] == [True, False, True, True]
    assert emission[0].all()
    assert not emission[1].any()


def test_a_log_without_responses_is_refused():
    log: EventLog = design_of([[(0, -1), (3, -1)]])
    with pytest.raises(InputError, match="recorded responses: found 0, wanted at least one"):
        recorded(log)
    assert recorded(design_of([[(2, 0), (3, -1), (3, 1)]])) == 2
