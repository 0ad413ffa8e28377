"""What a further drop costs in a process that has made one already.

A script: ``python3 -m benchmarks.further --model beam``. Mesh, matrices, factor, basis
and compiled code are there; march and flight are what is left.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Sequence

from mpi4py import MPI

from bristle.studies.inputs.choices import Model
from bristle.studies.inputs.config import DropInputs
from bristle.studies.running.cases import CaseSession


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the median of ``--times`` further drops as a line of JSON."""
    parser = argparse.ArgumentParser(prog="benchmarks.further", description=__doc__)
    parser.add_argument("--model", choices=[each.value for each in Model], default="beam")
    parser.add_argument("--cells", type=int, nargs=3, required=True)
    parser.add_argument("--modes", type=int, required=True)
    for name in ("--its", "--kn", "--height", "--beta"):
        parser.add_argument(name, type=float, required=True)
    parser.add_argument("--times", type=int, default=3)
    given = parser.parse_args(arguments)
    inputs = DropInputs(
        model=Model(given.model),
        cells=tuple(given.cells),
        modes=given.modes,
        its_s=given.its,
        kn_N_m=given.kn,
        height_m=given.height,
        beta_s=given.beta,
    )
    spent = []
    with CaseSession(MPI.COMM_WORLD) as session:
        session.run(inputs)
        for _ in range(given.times):
            started = time.perf_counter()
            session.run(inputs)
            spent.append(time.perf_counter() - started)
    print(json.dumps({"further_s": statistics.median(spent)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
