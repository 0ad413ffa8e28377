"""Films as grey pictures with time stamps, from any container that FFmpeg reads or a folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...solver.arrays import Array
from ...solver.errors import InputError
from ..inputs.choices import Down

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".webp")
LEAST_SIDE = 16
Picture = NDArray[np.uint8]
# Quarter turns, counterclockwise as numpy.rot90 has them, after which things fall down the rows.
TURNS = {Down.DOWN: 0, Down.LEFT: 1, Down.UP: 2, Down.RIGHT: 3}


@dataclass(frozen=True)
class Frame:
    """One picture: its number in the film, its time stamp in s, and grey levels (rows, columns)."""

    number: int
    t_s: float
    grey: Picture


@dataclass(frozen=True)
class Film:
    """A film or a folder of pictures, and how it is looked at.

    ``roi`` is x, y, width and height of the part that is used, in pixels of the picture as a player
    shows it. ``down`` is the way things fall there; frames are turned so that they fall down the
    rows. ``fps`` overrides the time stamps, and is needed for a folder.
    """

    path: Path
    fps: float | None = None
    roi: tuple[int, int, int, int] | None = None
    down: Down = Down.DOWN

    def frames(self, damaged: Callable[[str], None] | None = None) -> Iterator[Frame]:
        """The pictures one after the other; time counts from the first.

        Pictures end where the file does. Where it is damaged before its end, ``damaged`` is told so
        in a sentence. Raises InputError where nothing
        can be read, where time does not grow, and where ``roi`` lies outside.
        """
        if not self.path.exists():
            raise InputError(f"{self.path}: no such film")
        read = self._pictures() if self.path.is_dir() else self._decoded(damaged)
        first = last = shape = None
        for number, (stamp, grey) in enumerate(read):
            first = stamp if first is None else first
            t_s = number / self.fps if self.fps else stamp - first
            if last is not None and t_s <= last:
                raise InputError(
                    f"{self.path}: the time of frame {number} does not follow that of the frame "
                    "before; give the frames a second by --fps"
                )
            last = t_s
            if shape not in (None, grey.shape):
                raise InputError(f"{self.path}: frame {number} is not as large as the first")
            shape = grey.shape
            yield Frame(number, t_s, np.ascontiguousarray(self._turned(grey)))

    def shown(self, x: Array, y: Array, shape: tuple[int, int]) -> tuple[Array, Array]:
        """Columns and rows of the picture as a player shows it, from those of turned frames.

        ``shape`` has the rows and columns of a turned frame.
        """
        rows, columns = shape
        x, y = (
            (x, y),
            (rows - 1.0 - y, x),
            (columns - 1.0 - x, rows - 1.0 - y),
            (y, columns - 1.0 - x),
        )[TURNS[self.down]]
        left, top = (0, 0) if self.roi is None else self.roi[:2]
        return x + left, y + top

    def _turned(self, grey: Picture) -> Picture:
        rows, columns = grey.shape
        if self.roi is not None:
            x, y, width, height = self.roi
            if x + width > columns or y + height > rows:
                raise InputError(
                    f"{self.path}: --roi {x} {y} {width} {height} lies outside the picture, which "
                    f"has {columns} x {rows} pixels"
                )
            grey = grey[y : y + height, x : x + width]
        if min(grey.shape) < LEAST_SIDE:
            raise InputError(
                f"{self.path}: {grey.shape[1]} x {grey.shape[0]} pixels are too few to see in"
            )
        return np.rot90(grey, TURNS[self.down])

    def _pictures(self) -> Iterator[tuple[float, Picture]]:
        """The pictures of a folder, in the order of the numbers in their names."""
        paths = [path for path in self.path.iterdir() if path.suffix.lower() in PICTURES]
        if not paths:
            raise InputError(f"{self.path}: no pictures in this folder ({', '.join(PICTURES)})")
        if not self.fps:
            raise InputError(f"{self.path}: a folder of pictures needs --fps, the frames a second")
        full: float | None = None
        for path in sorted(paths, key=_by_number):
            try:
                with Image.open(path) as picture:
                    if picture.mode[0] in "IF":  # of more than eight bits
                        deep = np.asarray(picture, dtype=float)
                        # twelve bits are often written as sixteen
                        full = full or 2.0 ** np.ceil(np.log2(max(float(deep.max()), 255.0))) - 1.0
                        grey = np.clip(255.0 / full * deep, 0.0, 255.0).astype(np.uint8)
                    else:
                        grey = np.asarray(picture.convert("L"))
            except (OSError, ValueError, Image.DecompressionBombError) as error:
                raise InputError(f"{path}: cannot be read as a picture: {error}") from error
            yield 0.0, grey

    def _decoded(self, damaged: Callable[[str], None] | None) -> Iterator[tuple[float, Picture]]:
        """The pictures of a film, turned as its container says, and their time stamps."""
        count = 0
        try:
            with av.open(str(self.path.absolute())) as container:
                if not container.streams.video:
                    raise InputError(f"{self.path}: there is no film in this file")
                stream = container.streams.video[0]
                stream.thread_type = "AUTO"
                rate = float(stream.average_rate or stream.base_rate or 0.0)
                for frame in container.decode(stream):
                    if frame.time is None and not rate and not self.fps:
                        raise InputError(f"{self.path}: has no time stamps; give --fps")
                    stamp = frame.time if frame.time is not None else count / (rate or 1.0)
                    grey = frame.to_ndarray(format="gray")
                    yield float(stamp), np.rot90(grey, frame.rotation // 90 % 4)
                    count += 1
        except (av.error.FFmpegError, OSError, ValueError) as error:
            if not count:  # a film that is cut off ends where it does
                reason = getattr(error, "strerror", None) or error
                raise InputError(f"{self.path}: cannot be read as a film: {reason}") from error
            if damaged is not None:
                damaged(f"{self.path.name}: is damaged after frame {count - 1}, where it ends")
        if not count:
            raise InputError(f"{self.path}: there is no picture in this film")


def _by_number(path: Path) -> list[tuple[int, str]]:
    """A key that sorts names by the numbers in them."""
    return [
        (int(part), "") if part.isdigit() else (-1, part)
        for part in re.split(r"(\d+)", path.stem)
        if part
    ]
