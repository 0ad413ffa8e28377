"""Checkpoints of a long run, from which it resumes bit for bit.

A run consists of marches in a fixed order: the touches of a drop, or one march throughout. The
latest *mark* of each march is stored: all that its next step needs. What lies between marches is
computed again, with the same result. Each rank has its own files, plain arrays (no pickles) with a
version and a checksum. A mark is valid if all ranks have it whole.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .arrays import Array
from .cache import PART, read_arrays, write_arrays
from .errors import InputError, require

if TYPE_CHECKING:
    from mpi4py import MPI

SCHEMA = "bristle-checkpoint-5"
HEADER = "header"
# Tolerances on the start of a resumed march: rounding on another machine differs by less, two
# touches of one drop by far more.
SAME, NOTHING = 1e-9, 1e-15
# Steps between readings of the clock, which ranks share.
LOOK = 16


@dataclass(frozen=True)
class Mark:
    """The stored data of one march: the number of ``steps``, whether it was ``done``, ``arrays`` by
    name, and an observer's ``frames`` up to then, in order."""

    steps: int
    done: bool
    arrays: Mapping[str, Array]
    frames: list[Mapping[str, Array]]


class Checkpoint:
    """The marks of one run in ``folder``, at least ``every_s`` seconds apart.

    ``made_for`` names what the run depends on. With ``resume`` the run continues from the marks of
    an earlier one, and InputError names any difference; otherwise these are removed. The clock is
    read every ``look`` steps. All methods are collective over ``comm``.
    """

    def __init__(
        self,
        folder: Path,
        comm: MPI.Intracomm,
        made_for: Mapping[str, str],
        *,
        every_s: float = 60.0,
        resume: bool = False,
        look: int = LOOK,
    ) -> None:
        self.folder, self.comm, self.every_s, self._look = Path(folder), comm, every_s, look
        self._made_for = {"number of ranks": str(comm.size), **made_for}
        self._march, self._frames, self._whole_frames = -1, 0, 0
        self._start: list[float] = []
        self._looks, self._last_s = 0, time.monotonic()
        self._waiting: list[tuple[Path, Mapping[str, Array]]] = []
        self._there: dict[int, tuple[int, bool, int]] = {}
        if resume and self._agreed(self.folder.is_dir()):
            self._there = self._whole_marks()
        else:
            self._together(lambda: clear(self.folder), alone=True)

    def begin(self, *start: Array | float) -> Mark | None:
        """Start the next march, whose initial data are ``start``; returns its stored mark, or None.

        Raises InputError if the stored march started elsewhere: this run does not repeat the
        interrupted one.
        """
        self._march += 1
        self._start = [float(np.linalg.norm(each)) for each in start]
        found = self._there.get(self._march)
        if found is None:
            return None
        steps, done, last = found
        header, arrays = self._read(self._mark(self._march, steps))
        began = header["start"]
        same = len(began) == len(start) and np.allclose(began, self._start, SAME, NOTHING)
        if not self._agreed(bool(same)):
            raise InputError(
                f"{self.folder}: was kept for a march that began elsewhere than this one does; "
                "remove it, or do not resume"
            )
        frames: list[Mapping[str, Array]] = []
        while self._frames < last:
            frames.append(self._read(self._frame(self._frames))[1])
            self._frames += 1
        return Mark(steps, done, arrays, frames)

    def due(self) -> bool:
        """Whether a mark is due after this step."""
        self._looks += 1
        return self._looks % self._look == 0 and self._late()

    def save(self, steps: int, arrays: Mapping[str, Array], *, done: bool = False) -> None:
        """Store the running march's mark; ComputationError if the disk cannot take it.

        A march that is ``done`` before a mark is due waits in memory, as frames do.
        """
        path = self._mark(self._march, steps)
        header = {"march": self._march, "steps": steps, "done": done, "frames": self._frames}
        self._wait(path, {**header, "start": self._start}, arrays)
        if done and not self._late():
            return
        self._together(self._write_waiting)
        for old in self.folder.glob(f"march-{self._march}-*-{self.comm.rank}.npz"):
            if old != path:
                old.unlink(missing_ok=True)
        self._last_s = time.monotonic()

    def keep_frame(self, arrays: Mapping[str, Array]) -> None:
        """Store an observer's latest frame, so that a resumed run can show it again."""
        self._wait(self._frame(self._frames), {"march": self._march}, arrays)
        self._frames += 1

    def _late(self) -> bool:
        late = time.monotonic() - self._last_s >= self.every_s
        return bool(self.comm.bcast(late if self.comm.rank == 0 else None))

    # --- files ----------------------------------------------------------------------------------

    def _mark(self, march: int, steps: int) -> Path:
        return self.folder / f"march-{march}-{steps}-{self.comm.rank}.npz"

    def _frame(self, number: int) -> Path:
        return self.folder / f"frame-{number}-{self.comm.rank}.npz"

    def _wait(self, path: Path, header: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
        """Queue the present arrays for ``path``; they are written with the next mark."""
        text = json.dumps({"schema": SCHEMA, "made_for": self._made_for, **header})
        copies = {name: np.array(array) for name, array in arrays.items()}
        self._waiting.append((path, {HEADER: np.array(text), **copies}))

    def _write_waiting(self) -> None:
        while self._waiting:
            write_arrays(*self._waiting[0])
            del self._waiting[0]

    def _read(self, path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
        """Header and arrays of a file; ValueError or OSError if it is not whole."""
        arrays = read_arrays(path)
        header = json.loads(str(arrays.pop(HEADER, "{}")))
        if not isinstance(header, dict) or header.get("schema") != SCHEMA:
            raise ValueError(f"{path} is no {SCHEMA}")
        return header, arrays

    def _whole_marks(self) -> dict[int, tuple[int, bool, int]]:
        """By march: steps, whether it was done, and frames by then, of marks that all ranks have.

        Marches count up to the first without a mark. Files of other runs are refused.
        """
        mine, wrong = set(), None
        for path in sorted(self.folder.glob(f"march-*-{self.comm.rank}.npz")):
            try:
                header, _ = self._read(path)
            except (OSError, ValueError):
                continue
            wrong = wrong or self._difference(header["made_for"])
            mine.add((header["march"], header["steps"], header["done"], header["frames"]))
        for other in self.comm.allgather(wrong):
            if other:
                raise InputError(f"{self.folder}: {other}; remove it, or do not resume")
        every = set.intersection(*self.comm.allgather(mine))
        latest = {march: (steps, done, frames) for march, steps, done, frames in sorted(every)}
        there: dict[int, tuple[int, bool, int]] = {}
        for march in range(len(latest)):
            if march not in latest or not self._has_frames(latest[march][2]):
                break
            there[march] = latest[march]
            if not latest[march][1]:
                break
        return there

    def _has_frames(self, count: int) -> bool:
        """Whether all ranks have this many frames whole."""
        try:
            for i in range(self._whole_frames, count):
                self._read(self._frame(i))
                self._whole_frames = i + 1
        except (OSError, ValueError):
            return self._agreed(False)
        return self._agreed(True)

    def _difference(self, made_for: Mapping[str, str]) -> str | None:
        for name in {**self._made_for, **made_for}:
            if made_for.get(name) != self._made_for.get(name):
                return f"was kept for another {name}"
        return None

    # --- ranks ----------------------------------------------------------------------------------

    def _agreed(self, mine: bool) -> bool:
        return all(self.comm.allgather(mine))

    def _together(self, work: Callable[[], None], *, alone: bool = False) -> None:
        """Do ``work`` on every rank, or on the first ``alone``; fail on all if one fails."""
        problem = None
        if not alone or self.comm.rank == 0:
            try:
                work()
            except OSError as error:
                problem = error.strerror or str(error)
        message = f"the march cannot be kept in {self.folder}: {problem}"
        require(self.comm, problem is None, message)


def clear(folder: Path) -> None:
    """Remove the marks and frames of every run in ``folder``, and the folder if that empties it."""
    for pattern in ("march-*-*-*.npz", "frame-*-*.npz", f"tmp*{PART}"):
        for path in folder.glob(pattern):
            path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        folder.rmdir()


def prefixed(prefix: str, arrays: Mapping[str, Any]) -> dict[str, Array]:
    """Arrays with ``prefix`` before their names."""
    return {f"{prefix}.{name}": np.asarray(value) for name, value in arrays.items()}


def under(prefix: str, arrays: Mapping[str, Array]) -> Iterator[tuple[str, Array]]:
    """The arrays and names given to `prefixed`."""
    for name, value in arrays.items():
        if name.startswith(f"{prefix}."):
            yield name.removeprefix(f"{prefix}."), value
