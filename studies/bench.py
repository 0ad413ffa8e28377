"""`bristle bench`: runs the benchmarks that the repository keeps in tests/benchmarks."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from ..solver.errors import InputError
from .command.script import as_script

TESTS = Path(__file__).resolve().parents[1] / "tests"
# The options of each.
BENCHES: dict[str, tuple[str, ...]] = {
    "peers": ("repeats",),
    "step": ("repeats",),
    "sizes": ("largest",),
    "ranks": ("repeats", "most"),
}


def run_bench(what: str, out: Path | None, given: dict[str, Any]) -> str:
    """Run the benchmark ``what`` into ``out`` (None: its usual folder); its tables as text.

    ``given`` are options by name, None where they are not on the command line. Raises InputError
    for a name that is none, an option of another benchmark, or where the benchmarks are not there.
    """
    if what not in BENCHES:
        raise InputError(f"{what}: there is {', '.join(BENCHES)} to be measured")
    named = {name: value for name, value in given.items() if value is not None}
    for name in named:
        if name not in BENCHES[what]:
            owners = " and ".join(each for each, options in BENCHES.items() if name in options)
            raise InputError(f"--{name}: belongs to bench {owners}, not to bench {what}")
    if not (TESTS / "benchmarks").is_dir():
        raise InputError("bench: is in the repository, in tests/benchmarks; run it from there")
    sys.path.insert(0, str(TESTS))
    run = getattr(import_module(f"benchmarks.{what}"), f"run_{what}")
    return str(run(Path(f"results/bench-{what}") if out is None else out, **named))


if __name__ == "__main__":
    as_script("bench")
