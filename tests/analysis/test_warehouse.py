"""The invented experiment: its log, and that its export holds what it should, with the faults it should have."""

import numpy as np
import pytest

from analysis.warehouse import ARMS, LOST, ORDERS, pickers, raw_export, warehouse_truth
from models.errors import InputError
from models.protocol import PUBLISHED, Protocol

CONTENT = {
    "name": "warehouse",
    "modes": {
        "picker_in_need": {
            "letter": "P", "actions": {"pass": 0.0, "carry": 6.0}, "null_action": "pass", "shows_response": False,
        },
        "robot_stuck": {
            "letter": "S", "actions": {"wait": 0.0, "ask": 1.0, "thank": 2.0}, "null_action": "wait",
            "shows_response": True,
        },
    },
    "responses": {"drive_on": 0.0, "push": 1.0},
}  # fmt: skip


@pytest.fixture(scope="module")
def truth():
    return warehouse_truth(Protocol.from_dict(CONTENT, "warehouse"))


def test_people_are_drawn_from_the_tables(truth):
    log = pickers(truth, 6_000, np.random.default_rng(1))
    assert set(log.schedules()) == set(ORDERS)
    assert sorted(log.conditions) == sorted("+".join(arm) for arm in ARMS)
    first = log.to_frame().query("k == 0 and mode == 'robot_stuck'").astype(str)
    for action in ("wait", "ask", "thank"):
        own = first[first["action"] == action]["observation"] == "push"
        wanted = truth.response_probability(truth.initial, action)[1]
        assert own.mean() == pytest.approx(wanted, abs=4 * 0.5 / np.sqrt(len(own)))


def test_the_export_is_the_log_with_its_faults(truth):
    log = pickers(truth, 240, np.random.default_rng(1))
    raw = raw_export(log, np.random.default_rng(2))
    assert len(raw) == 240 * 8 + 2
    assert raw.duplicated().sum() == 2
    once = raw.drop_duplicates()
    assert once["participant.code"].nunique() == 240
    assert once.map(lambda value: isinstance(value, str)).all(axis=None)
    told = log.to_frame().astype(str)
    seen = once["player.clicked"] != ""
    answers = once["player.clicked"].map({"1": "push", "0": "drive_on"})[seen].to_numpy()
    assert (answers == told["observation"].to_numpy()[seen.to_numpy()]).all()
    gone = once["player.bot_did"] == ""
    assert 0 < gone.mean() < 0.3
    runs = gone.to_numpy().reshape(240, 8)
    assert (np.diff(runs.astype(int), axis=1) >= 0).all()  # who has left does not come back
    asked = (told["mode"].to_numpy() == "robot_stuck") & ~gone.to_numpy()
    assert (~seen.to_numpy())[asked].mean() == pytest.approx(LOST, abs=0.02)


def test_same_seed_same_export(truth):
    first, again = (
        raw_export(pickers(truth, 70, rng), rng) for rng in (np.random.default_rng(3), np.random.default_rng(3))
    )
    assert first.equals(again)


def test_another_protocol_is_refused():
    with pytest.raises(InputError, match="warehouse, modes of the protocol"):
        warehouse_truth(PUBLISHED)
