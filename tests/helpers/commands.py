"""The command line as a user runs it: in a process of its own, or in several."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from benchmarks.environment import unlaunched

LIVE = Path(__file__).parents[2] / "docker" / "live"


def environment() -> dict[str, str]:
    """The environment of a command that nobody launched as a rank, this repository importable.

    Of ranks that share cores with other tests, one that waits lets the others run.
    """
    kept = unlaunched()
    path = [str(LIVE), kept.get("PYTHONPATH", "")]
    return {
        **kept,
        "PYTHONPATH": os.pathsep.join(filter(None, path)),
        "OMP_NUM_THREADS": "1",
        "OMPI_MCA_mpi_yield_when_idle": "1",
    }


def python(*arguments: object, timeout_s: float = 600.0) -> subprocess.CompletedProcess[str]:
    """Run the interpreter with these arguments."""
    return _run([sys.executable, *map(str, arguments)], timeout_s)


def bristle(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command line."""
    return python("-m", "bristle.studies.cli", *arguments)


def mpirun(
    ranks: int, *arguments: object, timeout_s: float = 600.0
) -> subprocess.CompletedProcess[str]:
    """Run the interpreter with these arguments on so many ranks."""
    launch = ["mpirun", "-n", str(ranks), "--oversubscribe", sys.executable]
    return _run([*launch, *map(str, arguments)], timeout_s)


def _run(command: list[str], timeout_s: float) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        env=environment(),
        stdin=subprocess.DEVNULL,
        check=False,
    )
