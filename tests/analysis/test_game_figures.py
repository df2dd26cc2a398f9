"""Figures of the token game, and the rounds they show."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgba

from analysis.figures.game import COLOUR, round_course, state_scores_plot, tokens_by_kind, trap_panels
from analysis.figures.style import to_svg
from analysis.game_scenes import paper_scenes, simulated_round
from models.errors import InputError
from models.game.layout import packaged
from models.game.parameters import GameParameters
from models.game.render import Painter
from models.game.rounds import play_rounds


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_scenes_are_the_papers(seed):
    human, robot, signal = paper_scenes(seed)
    assert [scene.view.trapped for scene in (human, robot, signal)] == ["human", "robot", "robot"]
    assert [scene.view.flashing_room is not None for scene in (human, robot, signal)] == [False, False, True]
    assert Painter(signal.layout, signal.round_ticks).lit(signal.view)
    for scene, closed in ((human, "blue"), (robot, "red"), (signal, "red")):
        doors = dict(scene.view.doors)
        room = scene.layout.rooms[scene.view.trapped_room - 1]
        assert {doors[scene.layout.cell(int(number))] for number in room[:2]} == {closed}
        assert scene.view.freed_tick is None


def test_scenes_without_help_are_refused():
    slow = GameParameters(round_ticks=320, robot_help_delay=200)
    with pytest.raises(InputError, match="scene 'Human needs help', seed 1: found nobody helped"):
        paper_scenes(parameters=slow)


def test_a_simulated_round_is_that_of_the_batch():
    for trapped in (0, 1):
        for willing in (False, True):
            many = play_rounds(packaged(), GameParameters(), trapped, True, willing, [11])
            one = simulated_round(("human", "robot")[trapped], True, willing, 11).outcome
            for name in ("human_tokens", "robot_tokens", "trapped_tick", "freed_tick"):
                assert one[name] == getattr(many, name)[0]


def test_panels_with_captions_and_legend():
    scenes = paper_scenes()
    figure = trap_panels(scenes)
    shown = [ax for ax in figure.axes if ax.get_title(loc="left")]
    titles = [f"{letter}  {scene.title}" for letter, scene in zip("abc", scenes, strict=True)]
    assert [ax.get_title(loc="left") for ax in shown] == titles
    for ax, scene in zip(shown, scenes, strict=True):
        assert ax.get_xlabel().replace("\n", " ") == scene.caption
        painter = Painter(scene.layout, scene.round_ticks, 40)
        assert np.array_equal(ax.images[0].get_array(), painter.frame(scene.view))
    words = [text.get_text() for ax in figure.axes for text in ax.texts]
    assert words.count("lets it pass") == 2
    assert "room flashes" in words
    assert to_svg(trap_panels(scenes)) == to_svg(trap_panels(scenes))


@pytest.mark.parametrize(("trapped", "willing"), [("robot", True), ("robot", False), ("human", False)])
def test_course_of_a_round(trapped, willing):
    played = simulated_round(trapped, True, willing, 4)
    ax = round_course(played, "a round")
    for line, player in zip(ax.lines, ("human", "robot"), strict=True):
        assert line.get_ydata()[-1] == played.outcome[f"{player}_tokens"]
        assert line.get_xdata()[-1] == played.parameters.seconds
        assert line.get_color() == COLOUR[player]
    (span,) = ax.patches
    end = played.outcome["freed_tick"] / 10 if played.outcome["freed_tick"] >= 0 else played.parameters.seconds
    assert span.get_x() == played.outcome["trapped_tick"] / 10
    assert span.get_x() + span.get_width() == pytest.approx(end)
    words = " ".join(text.get_text() for text in ax.texts)
    assert f"{trapped} trapped" in words
    assert ("to the end" in words) == (played.outcome["freed_tick"] < 0)


def test_course_of_a_round_that_hardly_began():
    played = simulated_round(parameters=GameParameters(round_ticks=1))
    none = dataclasses.replace(played, inputs=played.inputs[:0], outcome={**played.outcome, "ticks": 0})
    assert not round_course(none).patches
    assert len(to_svg(round_course(none))) > 1000


def test_bars_are_means_and_lines_hold_nine_tenths():
    named, willing = np.repeat([0, 1, 1], 200), np.repeat([False, True, False], 200)
    played = play_rounds(packaged(), GameParameters(), named, True, willing, np.arange(600))
    kinds = {"human": played.trapped == 0, "helped": willing, "none": np.zeros(600, bool)}
    ax = tokens_by_kind(played, kinds)
    assert [t.get_text() for t in ax.get_yticklabels()] == list(kinds)
    bars = [p for p in ax.patches if p.get_height() == pytest.approx(0.62)]
    counts = (played.human_tokens, played.robot_tokens)
    wanted = [count[kind].mean() for kind in (kinds["human"], kinds["helped"]) for count in counts]
    assert [bar.get_width() for bar in bars] == pytest.approx(wanted)
    assert bars[0].get_facecolor() == to_rgba(COLOUR["human"])
    low, high = ax.lines[1].get_xdata()
    within = (played.team_tokens[willing] >= low) & (played.team_tokens[willing] <= high)
    assert 0.9 <= within.mean() < 0.97
    assert "no such round" in [text.get_text() for text in ax.texts]


def test_scores_beside_the_printed_ones():
    table = pd.DataFrame(
        {
            "quantity": ["x_s0", "x_s1", "C_help"],
            "measured": [46.0, 60.0, 6.0],
            "sd": [0.5, 1.0, 1.0],
            "printed": [45.0, 67.0, 15.0],
        }
    )
    ax = state_scores_plot(table, ("non-prosocial", "prosocial"))
    measured, printed = ax.containers[0][0], ax.lines[-1]
    assert measured.get_ydata().tolist() == [46.0, 60.0]
    assert (printed.get_ydata().tolist(), printed.get_marker()) == ([45.0, 67.0], "*")
    assert [t.get_text() for t in ax.get_xticklabels()] == ["s0 non", "s1 prosocial"]
    assert np.ptp(ax.containers[0][2][0].get_segments()[0][:, 1]) == pytest.approx(2.0)
