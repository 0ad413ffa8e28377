"""Writes pictures as a film that any player shows (H.264)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.video.stream import VideoStream
from numpy.typing import NDArray

from ...solver.errors import ComputationError


@contextmanager
def film_writer(
    path: Path, rate: int, rows: int, columns: int, quality: int = 20
) -> Iterator[Callable[[NDArray[np.uint8]], None]]:
    """A function that adds a picture (rows, columns, 3) to the film; H.264 wants even sides.

    ``quality`` is x264's rate factor, of which smaller is better. Raises ComputationError where the
    film cannot be written.
    """
    try:
        with av.open(str(path), "w") as container:
            # the tree of macroblocks differs from run to run: without it a film is the same again
            options = {"crf": str(quality), "preset": "medium", "x264-params": "no-mbtree=1"}
            stream = cast(VideoStream, container.add_stream("libx264", rate, options))
            stream.width, stream.height, stream.pix_fmt = columns, rows, "yuv420p"

            def add(picture: NDArray[np.uint8]) -> None:
                frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), "rgb24")
                container.mux(stream.encode(frame))

            yield add
            container.mux(stream.encode())
    except (av.error.FFmpegError, OSError) as error:
        raise ComputationError(f"{path.name}: the film cannot be written: {error}") from error
