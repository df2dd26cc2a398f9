"""Parameters of the token game: what is refused, and what kernels get."""

import json
from dataclasses import fields

import numpy as np
import pytest

from models.errors import InputError
from models.game.parameters import SETTING, GameParameters


def test_what_the_paper_prints():
    p = GameParameters()
    assert 10 / p.robot_step_ticks == 2  # cells a second
    assert (p.trap_tick, p.robot_help_delay) == (200, 50)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"round_ticks": 0}, "game parameters, round_ticks: found 0, wanted a whole number of ticks from 1"),
        ({"human_step_ticks": 2.5}, "game parameters, human_step_ticks: found 2.5"),
        ({"trap_tick": -1}, "game parameters, trap_tick: found -1"),
        ({"human_step_ticks": np.float64(2)}, "game parameters, human_step_ticks: found"),
        ({"trap_tick": np.bool_(True)}, "game parameters, trap_tick: found"),
        ({"round_ticks": np.int64(0)}, "game parameters, round_ticks: found"),
        ({"signal_notice_share": np.float32(1.5)}, "game parameters, signal_notice_share: found"),
        ({"robot_help_delay": True}, "game parameters, robot_help_delay: found True"),
        ({"clear_trapped_room": 1}, "game parameters, clear_trapped_room: found 1, wanted true or false"),
        ({"human_wander": 1.2}, "game parameters, human_wander: found 1.2, wanted a number from 0 to 1"),
        ({"human_wander": float("nan")}, "game parameters, human_wander: found nan"),
        ({"human_lapse": 0.95}, "human_lapse: found 0.95, wanted at most 0.9"),
        ({"signal_notice_share": "half"}, "signal_notice_share: found 'half'"),
        ({"round_ticks": 2_000_000}, "round_ticks: found 2000000"),
    ],
)
def test_unusable_values_are_named(given, message):
    with pytest.raises(InputError) as error:
        GameParameters(**given)
    assert message in str(error.value)


def test_numbers_of_numpy_become_plain_ones():
    given = GameParameters(
        round_ticks=np.int64(1730), human_step_ticks=np.uint8(5), human_wander=np.float64(0.1),
        human_lapse=np.float32(0.5), clear_trapped_room=np.bool_(False),
    )  # fmt: skip
    plain = GameParameters(human_lapse=0.5, clear_trapped_room=False)
    assert given == plain
    assert hash(given) == hash(plain)
    assert json.loads(json.dumps(given.to_dict())) == plain.to_dict()
    assert [type(value) for value in given.to_dict().values()] == [type(v) for v in plain.to_dict().values()]
    assert (given.settings == plain.settings).all()


def test_every_parameter_reaches_the_kernels():
    assert [f.name for f in fields(GameParameters)] == list(SETTING._fields)
    assert list(SETTING) == list(range(len(SETTING)))
    p = GameParameters(human_wander=0.25, signal_notice_share=1.0)
    assert p.settings[SETTING.human_wander] == 2**51
    assert p.settings[SETTING.signal_notice_share] == 2**53
    assert p.settings[SETTING.round_ticks] == p.round_ticks


def test_there_and_back():
    p = GameParameters(round_ticks=500, clear_trapped_room=False, human_lapse=0.2)
    assert GameParameters.from_dict(p.to_dict()) == p
    with pytest.raises(InputError, match="here, parameter: found 'speed', wanted one of round_ticks"):
        GameParameters.from_dict({"speed": 3}, "here")
    with pytest.raises(InputError, match="here: found 3"):
        GameParameters.from_dict(3, "here")
