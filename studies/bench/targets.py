"""Which benchmark is asked for, and which options belong to it?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...solver.errors import InputError


@dataclass(frozen=True)
class Target:
    """A benchmark: ``run`` takes the folder and those ``options`` that were given."""

    run: Callable[..., str]
    options: tuple[str, ...] = ()


def _peers(out: Path, **given: Any) -> str:
    from .peers import run_peers

    return run_peers(out, **given)


def _step(out: Path, **given: Any) -> str:
    from .step import run_step

    return f"{run_step(out, **given)}\n{'page':<24}{out / 'report.html'}"


def _sizes(out: Path, **given: Any) -> str:
    from .sizes import run_sizes

    return f"{run_sizes(out, **given)}\n{'page':<24}{out / 'report.html'}"


def _ranks(out: Path, **given: Any) -> str:
    from .ranks import run_ranks

    return f"{run_ranks(out, **given)}\n{'page':<24}{out / 'report.html'}"


TARGETS = {
    "peers": Target(_peers, ("repeats",)),
    "step": Target(_step, ("repeats",)),
    "sizes": Target(_sizes, ("largest",)),
    "ranks": Target(_ranks, ("repeats", "most")),
}


def run_bench(what: str, out: Path | None, given: dict[str, Any]) -> str:
    """Run the benchmark ``what`` into ``out`` (None: its usual folder); its table as text.

    ``given`` are options by name, None where they are not on the command line. Raises
    InputError for a name that is none, or an option of another benchmark.
    """
    if what not in TARGETS:
        raise InputError(f"{what}: there is {', '.join(TARGETS)} to be measured")
    target = TARGETS[what]
    named = {name: value for name, value in given.items() if value is not None}
    for name in named:
        if name not in target.options:
            owners = " and ".join(key for key, each in TARGETS.items() if name in each.options)
            raise InputError(f"--{name}: belongs to bench {owners}, not to bench {what}")
    return target.run(Path(f"results/bench-{what}") if out is None else out, **named)
