"""Lock of a folder that a run writes into.

The ranks of an mpirun that was killed compute on until they next talk to each other, and would put
what they find among what their successor does. A lock on the folder, which the system gives up with
the process that holds it, keeps one behind the other. Libraries of locks lock a file of their own,
which would have to lie among the results, or elsewhere for all machines that see the folder.
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


# Folders that a command holds, and their descriptors; None outside of commands.
_held: dict[Path, int] | None = None


@contextmanager
def locks() -> Iterator[None]:
    """A command: the folders that it locked are free again at its end."""
    global _held
    outer, _held = _held, {}
    try:
        yield
    finally:
        for descriptor in _held.values():
            os.close(descriptor)
        _held = outer


def lock_folder(folder: Path) -> None:
    """Wait until no other run writes into ``folder``, and keep others out until the command ends.

    Raises InputError where another goes on for ``PATIENCE_S``, OSError where it cannot be opened.
    """
    place = folder.resolve()
    if _held is None or place in _held:
        return
    descriptor = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _wait(descriptor, folder)
    except BaseException:
        os.close(descriptor)
        raise
    _held[place] = descriptor


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
