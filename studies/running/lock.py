"""Lock of a folder that a run writes into.

The ranks of an mpirun that was killed compute on until they next talk to each other, and would put
what they find among what their successor does. A lock on the folder, which the system gives up with
the process that holds it, keeps one behind the other.
"""

from __future__ import annotations

import errno
import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...solver.errors import InputError
from .progress import note

PATIENCE_S, AGAIN_S = 120.0, 0.1
# What file systems say that know no locks.
UNKNOWN = (errno.ENOLCK, errno.ENOTSUP, errno.EBADF, errno.EINVAL, errno.ENOSYS)


class _Locks:
    """Folders that a command holds: descriptors by path; None outside of commands."""

    def __init__(self) -> None:
        self.held: dict[Path, int] | None = None


_locks = _Locks()


@contextmanager
def locks() -> Iterator[None]:
    """A command: the folders that it locked are free again at its end."""
    outer, _locks.held = _locks.held, {}
    try:
        yield
    finally:
        for descriptor in _locks.held.values():
            os.close(descriptor)
        _locks.held = outer


def lock_folder(folder: Path) -> None:
    """Wait until no other run writes into ``folder``, and keep others out until the command ends.

    Raises InputError where another goes on for ``PATIENCE_S``, OSError where it cannot be opened.
    """
    held, place = _locks.held, folder.resolve()
    if held is None or place in held:
        return
    descriptor = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _wait(descriptor, folder)
    except BaseException:
        os.close(descriptor)
        raise
    held[place] = descriptor


def _wait(descriptor: int, folder: Path) -> None:
    until, announced = time.monotonic() + PATIENCE_S, False
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() > until:
                raise InputError(f"--out {folder}: another run is writing there") from None
        except OSError as error:
            if error.errno in UNKNOWN:
                return
            raise
        if not announced:
            note(f"waiting for another run that writes into {folder} …")
            announced = True
        time.sleep(AGAIN_S)
