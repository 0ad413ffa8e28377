"""What is costly to make and the same for all tests: made by the process that asks first."""

from __future__ import annotations

import fcntl
import os
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest
from mpi4py import MPI


def once[Made](
    factory: pytest.TempPathFactory, name: str, make: Callable[[Path], Made]
) -> tuple[Path, Made]:
    """The folder ``name`` and what ``make(folder)`` gave, the same in all processes of xdist.

    Under mpirun all ranks make it together, into the folder of rank 0.
    """
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / f"once-{name}"
    folder = Path(MPI.COMM_WORLD.bcast(str(folder)))
    if MPI.COMM_WORLD.size > 1:
        folder.mkdir(exist_ok=True)
        return folder, make(folder)
    kept = folder.with_suffix(".pickle")
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            folder.mkdir()
            kept.write_bytes(pickle.dumps(make(folder)))
        return folder, pickle.loads(kept.read_bytes())
