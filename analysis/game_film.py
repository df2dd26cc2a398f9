"""Films of recorded rounds of the token game: GIF by Pillow, MP4 by the optional imageio-ffmpeg."""

from __future__ import annotations

import importlib
import io
import itertools
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from models.errors import Phrase, located
from models.game.parameters import TICKS_A_SECOND
from models.game.record import RoundRecord, replay
from models.game.render import Frame, Painter
from models.game.render_sprites import CORRIDOR, INSIDE, SHADE, SPRITES, YELLOW, sprite
from models.game.render_walks import glides
from models.model_files import write_bytes

FILM_FPS = 30
"""Frames a second of an MP4."""

GIF_FPS = 10
"""Frames a second of a GIF: at most one a tick, since every frame costs bytes."""

GIF_MOST = 50

CRF = 20
"""Quality of H.264, from 0 (exact) to 51; 18 to 23 look alike on flat colours."""


def frames(
    played: RoundRecord, *, cell: int = 32, fps: float = FILM_FPS, speed: float = 1.0, glide: bool = True
) -> Iterator[Frame]:
    """Yield the frames of a film, ``uint8[height, width, 3]`` each; the last one is the end of the round.

    Parameters
    ----------
    played : RoundRecord
    cell : int
        Pixels a cell, even.
    fps : float
        Frames a second.
    speed : float
        Seconds of the game that pass in a second of the film.
    glide : bool
        Whether players walk smoothly from cell to cell; they jump otherwise, as the rules have it.

    Raises
    ------
    InputError
        On unusable numbers, or a record that does not replay.
    """
    for name, value in (("fps", fps), ("speed", speed)):
        if not 0 < value < float("inf"):
            raise located(f"film, {name}", value, "a number above 0")
    painter = Painter(played.layout, played.parameters.round_ticks, cell)
    views = list(replay(played))
    parameters = played.parameters
    ways = glides(views, (parameters.human_step_ticks, parameters.robot_step_ticks))
    last = len(views) - 1
    count = int(np.ceil(last * fps / (speed * TICKS_A_SECOND))) + 1
    for moment in np.minimum(np.arange(count) * speed * TICKS_A_SECOND / fps, last):
        tick = int(moment)
        share = moment - tick
        human, robot = (1 - share) * ways[tick] + share * ways[min(tick + 1, last)]
        yield painter.frame(views[tick], *((tuple(human), tuple(robot)) if glide else ()))


def write_film(
    played: RoundRecord,
    path: str | Path,
    *,
    cell: int | None = None,
    fps: float | None = None,
    speed: float = 1.0,
    glide: bool | None = None,
) -> Path:
    """Write a recorded round as ``.gif`` or ``.mp4``, whichever the path ends with.

    Parameters
    ----------
    played : RoundRecord
    path : str or Path
        A file there before is replaced once the film is complete.
    cell, fps, glide : optional
        As in `frames`; 32 pixels, 30 frames and smooth walks in an MP4; 24 pixels, 10 frames and jumps in a GIF.
    speed : float

    Raises
    ------
    InputError
        On another ending, a folder that is not there, unusable numbers, and for an MP4 without imageio-ffmpeg.
    """
    path = Path(path)
    if path.suffix not in FORMATS:
        raise located(f"film {path}", path.suffix or Phrase("no ending"), f"one of {', '.join(FORMATS)}")
    if not path.parent.is_dir():
        raise located(f"film {path}", Phrase(f"no folder {path.parent}"), "a folder that is there")
    default_cell, default_fps, default_glide, write = FORMATS[path.suffix]
    rate = default_fps if fps is None else fps
    pictures = frames(
        played, cell=default_cell if cell is None else cell, fps=rate, speed=speed,
        glide=default_glide if glide is None else glide,
    )  # fmt: skip
    write_bytes(path, write(pictures, rate))
    return path


def _gif(pictures: Iterator[Frame], fps: float) -> bytes:
    if fps > GIF_MOST:
        raise located("film, fps", fps, f"at most {GIF_MOST} in a GIF: browsers slow down what is faster")
    first = next(pictures)
    palette = _palette(first)
    shown = [_indexed(first, palette)]
    before, lasts = first, [1]
    for picture in pictures:
        if np.array_equal(picture, before):
            lasts[-1] += 1
        else:
            shown.append(_indexed(picture, palette))
            lasts.append(1)
            before = picture
    # Whole hundredths of a second are all that a GIF knows; rounding the ends keeps the film as long as it is.
    ends = np.round(np.cumsum(lasts) * 100 / fps)
    hundredths = np.diff(np.append(0, ends)).astype(int)
    buffer = io.BytesIO()
    shown[0].save(
        buffer, "GIF", save_all=True, append_images=shown[1:], duration=(10 * hundredths).tolist(), loop=0,
        optimize=False, disposal=1,
    )  # fmt: skip
    return buffer.getvalue()


def _palette(frame: Frame) -> Image.Image:
    """Make 255 colours for all frames: of the first, and of every small picture on what it may lie upon.

    The one left over stands for pixels that stay as they are.
    """
    side = 32
    floors = frame.reshape(-1, 3)[:: max(1, frame.size // 3 // 4096)]
    tiles = [np.resize(floors, (side, side, 3))]
    for floor in (CORRIDOR, INSIDE, SHADE, YELLOW):
        for name in SPRITES:
            picture = sprite(name, side).astype(float)
            opacity = picture[..., 3:] / 255
            tiles.append((picture[..., :3] * opacity + np.array(floor) * (1 - opacity)).astype(np.uint8))
    return Image.fromarray(np.vstack([*tiles, tiles[0]])).quantize(
        255, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE
    )


def _indexed(frame: Frame, palette: Image.Image) -> Image.Image:
    return Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)


def _mp4(pictures: Iterator[Frame], fps: float) -> bytes:
    try:
        ffmpeg: Any = importlib.import_module("imageio_ffmpeg")
    except ImportError:
        raise located(
            "film, MP4", Phrase("no package imageio-ffmpeg"), "the optional packages of the extra 'game', or a GIF"
        ) from None
    first = next(pictures)
    height, width = first.shape[:2]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        command = [
            ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
            "-s", f"{width}x{height}", "-r", str(fps), "-i", "-", "-an", "-c:v", "libx264", "-crf", str(CRF),
            "-preset", "veryfast", "-tune", "animation", "-pix_fmt", "yuv420p", "-threads", "1",
            "-movflags", "+faststart", "-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact",
            str(path),
        ]  # fmt: skip
        # What it says goes to a file: a full pipe that nobody reads would stop it.
        with tempfile.TemporaryFile() as said:
            with subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said
            ) as process:
                assert process.stdin is not None
                try:
                    for picture in itertools.chain([first], pictures):
                        process.stdin.write(np.ascontiguousarray(picture))
                except BrokenPipeError:
                    pass  # it has ended by itself, and says why
                except BaseException:
                    process.kill()
                    raise
            if process.returncode:
                said.seek(0)
                reason = " ".join(said.read().decode(errors="replace").replace(folder, "").split())
                raise located("film, MP4", Phrase(f"ffmpeg ended with: {reason}"), "a film")
        return path.read_bytes()


FORMATS: dict[str, tuple[int, float, bool, Callable[[Iterator[Frame], float], bytes]]] = {
    ".gif": (24, GIF_FPS, False, _gif),
    ".mp4": (32, FILM_FPS, True, _mp4),
}
"""Cell, frames a second, whether players glide, and the writer, by ending."""
