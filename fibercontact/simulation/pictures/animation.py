"""A run as an animation: GIF by Pillow, MP4 by ffmpeg."""

import importlib.util
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fibercontact.errors import UserError
from fibercontact.files import replacing
from fibercontact.simulation.pictures.camera import TILT, TURN, framed, view_axes
from fibercontact.simulation.pictures.shown import REGIMES, Shown, force_scale, held
from fibercontact.simulation.pictures.still import SIZE, caption, draw_shown, pixels
from fibercontact.simulation.scene import Scene

__all__ = ["AnimationError", "Picture", "ffmpeg", "gif_rate", "images", "write_gif", "write_mp4"]

Picture = NDArray[np.uint8]

COLOURS = 64  # of a GIF
WHITE = 248  # a level from which on it is made white, as the paper is


class AnimationError(UserError):
    """An animation that cannot be written; the message says why."""


def images(
    scene: Scene,
    frames: Sequence[Shown],
    fps: float,
    size: int = SIZE,
    turn: float = TURN,
    tilt: float = TILT,
) -> Iterator[Picture]:
    """The frames' pictures (height, width, 3), all seen through one window, forces at one scale.

    `fps` is how many are shown a second: the title says how that compares with the scene's own time.
    """
    camera = framed(view_axes(turn, tilt), [group for shown in frames for group in held(shown)], size)
    newton = force_scale(frames, camera.width / camera.scale)
    pace = (frames[-1].time - frames[0].time) * fps / max(1, len(frames) - 1)
    for shown in frames:
        more = f", {pace:.2g} × real time" if len(frames) > 1 else ""
        yield pixels(draw_shown(shown, camera, newton, caption(scene, shown, more)))


def gif_rate(fps: float) -> float:
    """The rate nearest to `fps` that a GIF can have: its pictures last whole hundredths of a second."""
    return 100.0 / max(2, round(100.0 / fps))


def write_gif(file: Path, pictures: Iterable[Picture], fps: float) -> int:
    """Write pictures as a GIF that repeats; returns how many. Ctrl-C ends it after those that are drawn."""
    drawn: list[Image.Image] = []
    palette = None
    try:
        for picture in pictures:
            image = Image.fromarray(picture)
            palette = palette or _palette(image)
            drawn.append(image.quantize(palette=palette, dither=Image.Dither.NONE))
    except KeyboardInterrupt:
        if not drawn:
            raise
    with replacing(file) as draft:
        drawn[0].save(
            draft,
            save_all=True,
            append_images=drawn[1:],
            duration=round(1e3 / gif_rate(fps)),
            loop=0,
            optimize=True,
        )
    return len(drawn)


def _palette(image: Image.Image) -> Image.Image:
    """Colours of a picture, those of the regimes among them: dots are too few to be found by themselves."""
    kept = [int(colour[k : k + 2], 16) for _, colour, _ in REGIMES.values() for k in (1, 3, 5)]
    found = (image.quantize(COLOURS - len(REGIMES)).getpalette() or [])[: 3 * (COLOURS - len(REGIMES))]
    palette = Image.new("P", (1, 1))
    palette.putpalette(kept + [255 if level >= WHITE else level for level in found])
    return palette


def write_mp4(file: Path, pictures: Iterable[Picture], fps: float) -> int:
    """Write pictures as an MP4; returns how many. Ctrl-C ends it after those that are drawn.

    Raises `AnimationError` without ffmpeg, or with what it says when it fails.
    """
    program, left = ffmpeg(), iter(pictures)
    first = next(left)
    with replacing(file) as draft, _encoder(program, draft, first.shape, fps) as process:
        count = _feed(process, chain([first], left))
        _, said = process.communicate()
        if process.returncode:
            why = said.decode(errors="replace").strip() or "no reason given"
            raise AnimationError(f"{file}: ffmpeg failed: {why}")
    return count


def _feed(process: "subprocess.Popen[bytes]", pictures: Iterable[Picture]) -> int:
    """Give an encoder pictures until they end, or Ctrl-C does it; returns how many."""
    assert process.stdin is not None
    count = 0
    try:
        for picture in pictures:
            process.stdin.write(picture.tobytes())
            count += 1
    except KeyboardInterrupt:
        pass
    except BrokenPipeError:
        pass  # the encoder has ended, and says why
    return count


def _encoder(program: str, file: Path, shape: tuple[int, ...], fps: float) -> "subprocess.Popen[bytes]":
    """ffmpeg, waiting for pictures; in a session of its own, so that Ctrl-C does not reach it."""
    height, width, _ = shape
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "-"]
    wanted = ["-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart", "-f", "mp4"]
    return subprocess.Popen(
        [program, "-loglevel", "error", "-y", *given, *wanted, f"file:{file}"],
        stdin=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


def ffmpeg() -> str:
    """The program that encodes films; raises `AnimationError` saying how to get it."""
    if found := shutil.which("ffmpeg"):
        return found
    if importlib.util.find_spec("imageio_ffmpeg"):
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    raise AnimationError(
        "an MP4 needs ffmpeg: install your system's package, or `pip install 'fibercontact[film]'`; "
        "a GIF needs nothing more"
    )
