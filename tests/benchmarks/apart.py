"""Functions of these benchmarks, called in processes of their own: what they return, as JSON.

``mpirun -n 2 python3 -m benchmarks.apart jobs.solids '{"cells": …}'`` prints one line of it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict
from importlib import import_module
from typing import Any

from bristle.solver.errors import ComputationError

from .environment import unlaunched
from .machine import with_benchmarks

TIMEOUT_S = 3600.0


def call(what: str, **arguments: object) -> list[str]:
    """What the interpreter is to be told, for the function ``what`` of a module of this package."""
    return ["-m", "benchmarks.apart", what, json.dumps(arguments)]


def apart(words: list[str], ranks: int = 0, **variables: str) -> Any:
    """What a `call` returns, on so many ``ranks`` of mpirun if any, with ``variables`` beside the
    environment; ComputationError where it does not end well."""
    launch = ["mpirun", "-n", str(ranks), "--oversubscribe"] if ranks else []
    where = f"a job on {ranks} ranks" if ranks else "a process of its own"
    try:
        done = subprocess.run(
            [*launch, sys.executable, *words],
            capture_output=True,
            text=True,
            env={**with_benchmarks(unlaunched()), **variables},
            stdin=subprocess.DEVNULL,
            timeout=TIMEOUT_S if ranks else None,
            check=True,
        )
        return json.loads(done.stdout.splitlines()[-1])
    except FileNotFoundError as error:
        raise ComputationError("there is no mpirun here") from error
    except subprocess.TimeoutExpired as error:
        raise ComputationError(f"{where} took over {TIMEOUT_S:g} s") from error
    except (subprocess.CalledProcessError, IndexError, ValueError) as error:
        told = getattr(error, "stderr", None) or str(error)
        last = [line for line in told.splitlines() if line.strip()][-1:]
        raise ComputationError(f"{where} failed: {' '.join(last)}") from error


def main(what: str, arguments: Mapping[str, Any]) -> None:
    """Call it and print what it returns, from rank 0."""
    module, _, name = what.partition(".")
    given = {key: tuple(x) if isinstance(x, list) else x for key, x in arguments.items()}
    found = getattr(import_module(f"benchmarks.{module}"), name)(**given)
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found, default=asdict), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], json.loads(sys.argv[2]))
