"""Films as grey pictures with time stamps, from any container that FFmpeg reads or a folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.video.stream import VideoStream
from numpy.typing import NDArray
from PIL import Image

from ...solver.arrays import Array
from ...solver.errors import InputError
from ..inputs.choices import Down

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".webp")
LEAST_SIDE = 16
INTERLACED = (
    "is interlaced: each picture shows two instants, row by row, so what moves is off by more than "
    "its standard error; make a film of its fields first"
)
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

        Pictures end where the file does. Where it is damaged before its end, or interlaced,
        ``damaged`` is told so in a sentence. Raises InputError where nothing can be read, where
        time does not grow, and where ``roi`` lies outside.
        """
        if not self.path.exists():
            raise InputError(f"{self.path}: no such film")
        read = self._pictures() if self.path.is_dir() else self._decoded(damaged)
        first = last = shape = None
        for number, stamp, grey in read:
            first = stamp if first is None else first
            t_s = stamp - first
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

    def _pictures(self) -> Iterator[tuple[int, float, Picture]]:
        """Numbers, instants and grey levels of a folder's pictures, as numbers in names order
        them."""
        paths = [path for path in self.path.glob("[!.]*") if path.suffix.lower() in PICTURES]
        if not paths:
            raise InputError(f"{self.path}: no pictures in this folder ({', '.join(PICTURES)})")
        if not self.fps:
            raise InputError(f"{self.path}: a folder of pictures needs --fps, the frames a second")
        paths.sort(key=_by_number)
        # twelve bits are often written as sixteen, and a bright body may come later
        deep = [float(_levels(path).max()) for path in paths if _is_deep(path)]
        white = 2.0 ** np.ceil(np.log2(max([*deep, 255.0]))) - 1.0
        for place, path in zip(_places(paths), paths, strict=True):
            levels = _levels(path)
            if levels.dtype != np.uint8:
                levels = np.clip(255.0 / white * levels.astype(float), 0.0, 255.0)
            yield place, place / self.fps, levels.astype(np.uint8)

    def _decoded(
        self, damaged: Callable[[str], None] | None
    ) -> Iterator[tuple[int, float, Picture]]:
        """Numbers, time stamps and grey levels of the pictures of a film."""
        tell = damaged or (lambda sentence: None)
        count, sound, cut, reason = 0, True, False, ""
        lost: list[int] = []
        try:
            with av.open(str(self.path.absolute())) as container:
                if not container.streams.video:
                    raise InputError(f"{self.path}: there is no film in this file")
                stream = container.streams.video[0]
                stream.thread_type = "AUTO"
                for packet in container.demux(stream):
                    try:
                        frames = cast(list[av.VideoFrame], packet.decode())
                    except av.error.FFmpegError as error:
                        frames, sound, reason = [], False, str(error.strerror)
                        lost.append(count)
                        count += 1
                    for frame in frames:
                        # what follows a damaged picture is made from it, until one stands alone
                        sound = not frame.is_corrupt and (sound or frame.key_frame)
                        if sound:
                            if count == len(lost) and frame.interlaced_frame:
                                tell(f"{self.path.name}: {INTERLACED}")
                            yield count, self._stamp(frame, stream, count), _grey(frame, stream)
                        else:
                            lost.append(count)
                        count += 1
        except (av.error.FFmpegError, OSError, ValueError) as error:
            reason, cut = getattr(error, "strerror", None) or str(error), True
        if count == len(lost):
            reason = reason or ("every picture is damaged" if lost else "it has no picture")
            raise InputError(f"{self.path}: cannot be read as a film: {reason}")
        # a film that is cut off ends where it does
        ends = bool(lost) and lost[0] == count - len(lost)
        if cut or ends:
            last = (lost[0] if ends else count) - 1
            tell(f"{self.path.name}: is damaged after frame {last}, where it ends")
        if lost and not ends:
            several = "s are" if len(lost) > 1 else " is"
            left = f"{len(lost)} picture{several} left out"
            tell(f"{self.path.name}: is damaged, first at frame {lost[0]}; {left}")

    def _stamp(self, frame: av.VideoFrame, stream: VideoStream, count: int) -> float:
        """The instant of a picture, before which ``count`` come in the film."""
        rate = float(stream.guessed_rate or stream.average_rate or 0.0)
        if self.fps or frame.time is None:
            if not (self.fps or rate):
                raise InputError(f"{self.path}: has no time stamps; give --fps")
            return count / (self.fps or rate)
        # containers round: what may be an even rate by their ticks is one
        even = round(frame.time * rate) / rate if rate else np.inf
        half = 0.5 * float(stream.time_base or 0.0) + 1e-9
        return even if abs(even - frame.time) <= half else frame.time


def _grey(frame: av.VideoFrame, stream: VideoStream) -> Picture:
    """Grey levels of a picture as a player shows it: turned, and of square pixels."""
    wide = round(frame.width * float(stream.sample_aspect_ratio or 1.0))
    grey = frame.reformat(width=wide, format="gray").to_ndarray()
    return np.rot90(grey, frame.rotation // 90 % 4)


@contextmanager
def _opened(path: Path) -> Iterator[Image.Image]:
    """A picture of a folder, of which nothing but the head is read yet; InputError where it is
    none."""
    try:
        with Image.open(path) as picture:
            yield picture
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: cannot be read as a picture: {error}") from error


def _is_deep(path: Path) -> bool:
    """Whether a picture has more than eight bits."""
    with _opened(path) as picture:
        return picture.mode[0] in "IF"


def _levels(path: Path) -> Array | Picture:
    """Grey levels of a picture, of eight bits or deeper ones as they are written."""
    with _opened(path) as picture:
        return np.asarray(picture if picture.mode[0] in "IF" else picture.convert("L"))


def _places(paths: Sequence[Path]) -> list[int]:
    """Which picture of an even row each one is: numbers in their names show which are missing."""
    numbers = [[int(part) for part in re.findall(r"\d+", path.stem)] for path in paths]
    if len(set(map(len, numbers))) == 1:
        # such as dates, numbers may be longer than those of the machine
        first = numbers[0]
        apart = [[one - other for one, other in zip(row, first, strict=True)] for row in numbers]
        counts = [column for column in np.array(apart, dtype=float).T if np.ptp(column)]
        if len(counts) == 1:
            steps = np.diff(counts[0])
            step = int(np.median(steps))
            if step and steps.min() == step and not np.any(steps % step):
                return [int(each) // step for each in counts[0] - counts[0][0]]
    return list(range(len(paths)))


def _by_number(path: Path) -> list[tuple[int, str]]:
    """A key that sorts names by the numbers in them."""
    return [
        (int(part), "") if part.isdigit() else (-1, part)
        for part in re.split(r"(\d+)", path.stem)
        if part
    ]
