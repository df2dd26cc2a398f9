"""Settings of the game beside each other, and maps of four rooms."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis import game_settings
from analysis.evidence import read_evidence
from analysis.game_calibration import calibrate_game
from analysis.study2_evidence import game_settings as settings_of_the_game
from models.errors import InputError
from models.game.layout import packaged
from models.game.parameters import GameParameters


def test_the_packaged_map_is_the_smallest():
    assert game_settings.four_rooms().lines == packaged().lines


@settings(max_examples=20)
@given(*(st.integers(1, 7) for _ in range(4)))
def test_maps_have_what_was_asked_for(height, width, rows, columns):
    if height * width < 3:
        with pytest.raises(InputError, match="room"):
            game_settings.four_rooms(height, width, rows, columns)
        return
    lines = game_settings.four_rooms(height, width, rows, columns).lines
    assert (len(lines), len(lines[0])) == (2 * height + rows + 8, 2 * width + columns + 8)
    text = "".join(lines)
    assert [text.count(c) for c in "1234"] == [height * width] * 4
    assert (text.count("r"), text.count("b"), text.count("H"), text.count("R")) == (4, 4, 1, 1)
    # Turned by half a circle, with the players changed over, the doors lie in the same walls.
    upper, lower = lines[2], lines[-3]
    assert upper.count("b") == lower.count("b") == 2


@pytest.mark.parametrize("size", [{"height": 0}, {"between_columns": 41}])
def test_unusable_maps_are_refused(size):
    name = next(iter(size))
    with pytest.raises(InputError, match=f"{name}: found {size[name]}, wanted a whole number from 1 to 40"):
        game_settings.four_rooms(**size)


def test_the_default_is_among_those_tried():
    tried = game_settings.settings_tried()
    assert len({s.name for s in tried}) == len(tried)
    assert len({(s.layout.lines, s.parameters) for s in tried}) == len(tried)
    assert sum(s.parameters == GameParameters() and s.layout.lines == packaged().lines for s in tried) == 1


def test_settings_are_compared():
    short = game_settings.GameSetting("short", packaged(), GameParameters(round_ticks=600))
    default = game_settings.GameSetting("default", packaged(), GameParameters())
    seen = []
    found = game_settings.compare_settings([short, default], studies=2, progress=lambda *at: seen.append(at))
    assert seen == [(1, 2), (2, 2)]
    assert found["setting"].tolist() == ["default", "short"]
    assert found["brackets"].tolist() == [True, False]
    own = calibrate_game(parameters=short.parameters, studies=2)
    row = found.iloc[1]
    assert row[["x_s0", "x_s1", "x_s2", "x_s3"]].tolist() == own.scores.tolist()
    assert (row["rms"], row["largest"], row["seconds"]) == (own.rms, own.tolerance, 60.0)
    words = game_settings.compared_sentence(found)
    assert words.startswith("1 of 2 settings bracket the printed scores.")
    assert "'default'" in words
    assert "and brackets them" in words


def test_words_when_the_closest_does_not_bracket():
    columns = ["setting", "brackets", "rms", "seconds", "C_help"]
    rows = [["a", True, 6.4, 173.0, 6.0], ["b", True, 6.6, 390.0, 14.0], ["c", False, 4.7, 340.0, 16.0]]
    table = pd.DataFrame(rows, columns=columns)
    assert game_settings.compared_sentence(table) == (
        "2 of 3 settings bracket the printed scores. The closest to the printed scores, 'c', has a root mean "
        "square distance of 4.7, those that bracket them 6.4 to 6.6. Of those, helping costs 6.0 s in the shortest "
        "rounds (173 s), and at the most 14.0 s, 'b', in rounds of 390 s."
    )
    assert game_settings.compared_sentence(table.iloc[2:]).endswith("distance of 4.7.")


def test_no_settings():
    with pytest.raises(InputError, match="settings of the game: found none, wanted at least one"):
        game_settings.compare_settings([])


def test_narrow_columns_are_those_of_the_table():
    row = {"setting": "a", "seconds": 80.0, "human_step_ticks": 13, "human_lapse": 0.25, "x_s0": 40.0, "x_s1": 50.0}
    row |= {"brackets": False, "rms": 3.0, "C_help": 6.0, "C_signal": 20.0, "unseen": 0}
    assert game_settings.narrow(pd.DataFrame([row])).to_dict("records") == [
        {
            "setting": "a", "round": 80.0, "step": 1.3, "lapses": 25.0, "x0": 40.0, "x1": 50.0, "brackets": False,
            "rms": 3.0, "help": 6.0, "signal": 20.0,
        }
    ]  # fmt: skip


def test_stored_evidence_can_be_repeated():
    """The shortest rounds that were tried, played again."""
    found = read_evidence("game")
    assert found is not None
    if found.stale or found.content["game"] != settings_of_the_game():
        pytest.skip("stored evidence is stale: the report says so")
    content = found.content
    stored = min(content["search"], key=lambda row: row["seconds"])
    setting = next(s for s in game_settings.settings_tried() if s.name == stored["setting"])
    again = game_settings.compare_settings([setting], studies=content["search_studies"], seed=content["seed"])
    played = again.to_dict("records")[0]
    assert played.keys() == stored.keys()
    for name, value in stored.items():
        assert played[name] == (pytest.approx(value, rel=1e-9) if isinstance(value, float) else value), name


@pytest.mark.slow
def test_what_the_search_shows():
    """Several maps bracket; on the packaged one helping costs 6 s; near 15 only with rooms far apart."""
    table = game_settings.compare_settings(studies=4).set_index("setting")
    held = table[table["brackets"]]
    assert {"default", "slow steps", "corridors of 10"} <= {*held.index}
    assert held["rms"].between(6, 7).all()
    assert (np.diff(table[["x_s0", "x_s1", "x_s2", "x_s3"]].to_numpy(), axis=1) > 0).all()
    assert (table["unseen"] == 0).all()
    assert held.loc[held["map"] == "four_rooms", "C_help"].max() < 7
    far = held[held["C_help"] > 12]
    assert len(far)
    assert (far["seconds"] > 300).all()
