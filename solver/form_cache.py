"""Cache of compiled UFL forms, safe against other processes and against interruption.

FFCx keeps compiled forms on disk. A process that finds an unfinished one waits ten seconds and then
fails, even if the process that started it was killed. Here every process, rank or not, compiles
while it holds a lock, which the system releases when a process dies. So whatever is unfinished when
the lock is acquired was abandoned, and is removed.
"""

from __future__ import annotations

import fcntl
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem, jit
from mpi4py import MPI

from .arrays import Array
from .compiled import process_folder, writable_folder

LOCK = "lock"


def form(expression: ufl.Form) -> Any:
    """The form, compiled by this rank alone or read from disk; RuntimeError if that fails."""
    with _alone() as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Applying str")  # for points of custom quadrature
        options = {"cache_dir": str(folder)}
        jit.ffcx_jit(MPI.COMM_SELF, expression, {"scalar_type": default_scalar_type}, options)
    return fem.form(expression, jit_options=options)  # all ranks find it compiled, so none waits


def expression(value: ufl.core.expr.Expr, points: Array) -> fem.Expression:
    """``value`` at reference ``points`` (n, 3) of a cell, compiled like a form."""
    with _alone() as folder:
        return fem.Expression(
            value, np.asarray(points), MPI.COMM_SELF, jit_options={"cache_dir": str(folder)}
        )


@contextmanager
def _alone() -> Iterator[Path]:
    """The folder of compiled forms, locked against other processes."""
    folder = _folder()
    with (folder / LOCK).open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        for source in folder.glob("*.c"):
            if not source.with_suffix(".c.cached").exists():
                source.unlink()
        yield folder


@cache
def _folder() -> Path:
    """A folder that can be written and locked: the user's, or this process' own."""
    folder = writable_folder("forms")
    try:
        with (folder / LOCK).open("w") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        pass  # another process holds it, so it works
    except OSError:
        return process_folder("forms")
    return folder
