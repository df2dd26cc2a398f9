"""Films of recorded rounds: read back by other programs and compared with the frames they were made from."""

import dataclasses
import re
import subprocess
import sys

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from analysis.game_film import frames, write_film
from analysis.game_scenes import simulated_round
from models.errors import InputError
from models.game.parameters import GameParameters
from models.game.record import replay
from models.game.render import Painter

SHORT = GameParameters(round_ticks=90, trap_tick=20)


@pytest.fixture(scope="module")
def played():
    return simulated_round("robot", True, True, 2, parameters=SHORT)


def test_a_frame_a_tick_is_the_round(played):
    painter = Painter(played.layout, SHORT.round_ticks, 16)
    views = list(replay(played))
    shown = list(frames(played, cell=16, fps=10, glide=False))
    assert len(shown) == len(views) == 91
    assert all(np.array_equal(frame, painter.frame(view)) for frame, view in zip(shown, views, strict=True))


@pytest.mark.parametrize(("fps", "speed", "count"), [(30, 1, 271), (10, 2, 46), (24, 0.5, 433), (7, 1.3, 50)])
def test_a_film_lasts_as_long_as_it_should_and_ends_with_the_round(played, fps, speed, count):
    shown = list(frames(played, cell=12, fps=fps, speed=speed))
    assert len(shown) == count == int(np.ceil(9 * fps / speed)) + 1
    last = Painter(played.layout, SHORT.round_ticks, 12).frame(list(replay(played))[-1])
    assert np.array_equal(shown[-1], last)


def test_gliding_players_are_between_cells(played):
    smooth, jumping = (list(frames(played, cell=12, fps=10, glide=glide)) for glide in (True, False))
    differ = [not np.array_equal(a, b) for a, b in zip(smooth, jumping, strict=True)]
    assert 0.3 < np.mean(differ) < 1


def test_gif(played, tmp_path):
    path = write_film(played, tmp_path / "round.gif")
    made = list(frames(played, cell=24, fps=10, glide=False))
    with Image.open(path) as film:
        assert film.size == made[0].shape[1::-1]
        assert film.info["loop"] == 0
        durations, shown = [], []
        for i in range(film.n_frames):
            film.seek(i)
            durations.append(film.info["duration"])
            shown.append(np.asarray(film.convert("RGB")))
    assert sum(durations) == 9100
    starts = np.cumsum([0, *durations[:-1]])
    for i, frame in enumerate(made):
        found = shown[int(np.searchsorted(starts, 100 * i, side="right")) - 1]
        # A palette of 255: no pixel is far off, hardly any is off at all.
        error = np.abs(found.astype(int) - frame).max(axis=-1)
        assert error.max() < 60
        assert error.mean() < 2
    assert write_film(played, tmp_path / "again.gif").read_bytes() == path.read_bytes()


def test_mp4(played, tmp_path):
    path = write_film(played, tmp_path / "round.mp4", cell=24, fps=20, speed=2)
    made = list(frames(played, cell=24, fps=20, speed=2))
    program = imageio_ffmpeg.get_ffmpeg_exe()
    facts = subprocess.run([program, "-i", path], capture_output=True, text=True, check=False).stderr
    height, width = made[0].shape[:2]
    assert re.search(rf"Video: h264 .* yuv420p.*, {width}x{height}.*, 20 fps", facts)
    raw = subprocess.run(
        [program, "-loglevel", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
        capture_output=True, check=True,
    ).stdout  # fmt: skip
    shown = np.frombuffer(raw, dtype=np.uint8).reshape(-1, height, width, 3)
    assert len(shown) == len(made)
    for frame, wanted in zip(shown, made, strict=True):
        assert np.abs(frame.astype(int) - wanted).mean() < 4


def test_the_endings_of_unfinished_rounds(played, tmp_path):
    begun = dataclasses.replace(
        played, inputs=played.inputs[:0], outcome={**dict.fromkeys(played.outcome, 0), "trapped_tick": -1,
        "freed_tick": -1}
    )  # fmt: skip
    assert len(list(frames(begun, cell=12))) == 1
    with Image.open(write_film(begun, tmp_path / "begun.gif")) as film:
        assert film.n_frames == 1


@pytest.mark.parametrize(
    ("name", "arguments", "wanted"),
    [
        ("round.webm", {}, r"round\.webm: found '\.webm', wanted one of \.gif, \.mp4"),
        ("round", {}, r"round: found no ending, wanted one of"),
        ("round.gif", {"fps": 60}, "film, fps: found 60, wanted at most 50 in a GIF"),
        ("round.gif", {"fps": 0}, "film, fps: found 0, wanted a number above 0"),
        ("round.mp4", {"speed": float("nan")}, "film, speed: found nan, wanted a number above 0"),
        ("round.gif", {"cell": 7}, "painter, cell: found 7, wanted an even number"),
    ],
)
def test_refused_and_what_was_there_stays(played, tmp_path, name, arguments, wanted):
    path = tmp_path / name
    path.write_text("before")
    with pytest.raises(InputError, match=wanted):
        write_film(played, path, **arguments)
    assert path.read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_a_mistyped_folder_is_not_made(played, tmp_path):
    with pytest.raises(InputError, match=r"round\.gif: found no folder .*nowhere, wanted a folder that is there"):
        write_film(played, tmp_path / "nowhere" / "round.gif")
    assert not list(tmp_path.iterdir())


def test_a_changed_record_is_refused(played, tmp_path):
    changed = dataclasses.replace(played, outcome={**played.outcome, "human_tokens": 99})
    with pytest.raises(InputError, match="human_tokens: found 99"):
        write_film(changed, tmp_path / "round.gif")


def test_what_ffmpeg_says_is_passed_on(played, tmp_path, monkeypatch):
    monkeypatch.setattr("analysis.game_film.CRF", "high")
    with pytest.raises(InputError, match=r"^film, MP4: found ffmpeg ended with: .*high.*, wanted a film$"):
        write_film(played, tmp_path / "round.mp4", cell=12, fps=5)
    assert not list(tmp_path.iterdir())


def test_without_imageio_ffmpeg(played, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    wanted = r"^film, MP4: found no package imageio-ffmpeg, wanted .* extra 'game', or a GIF$"
    with pytest.raises(InputError, match=wanted):
        write_film(played, tmp_path / "round.mp4")
    write_film(played, tmp_path / "round.gif", cell=12)
