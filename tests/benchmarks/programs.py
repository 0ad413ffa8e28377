"""Programs that compute the same impact: how each is called, and what it answers."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bristle
from bristle.solver import paper
from bristle.solver.compiled import cache_folder
from bristle.studies.inputs.fields import MODES

from .apart import call
from .environment import unlaunched
from .machine import with_benchmarks

REFERENCES = Path(__file__).resolve().parents[1] / "reference"
QUANTITIES = ("rebound_ratio", "contact_time_s", "peak_force_N")
HEIGHT_M = 0.05


@dataclass(frozen=True)
class Physics:
    """One impact: an upright drop from 50 mm on Kn = 2 MN/m, with the damping ``beta_s``."""

    name: str
    beta_s: float
    kn_N_m: float = paper.KN_CHOSEN_N_M
    height_m: float = HEIGHT_M

    def numbers(self) -> dict[str, float]:
        """By the names under which all programs take them."""
        return {"kn": self.kn_N_m, "height": self.height_m, "beta": self.beta_s}


def options(numbers: Mapping[str, object]) -> list[str]:
    """As all programs take them."""
    return [text for name, value in numbers.items() for text in (f"--{name}", repr(value))]


DAMPED = Physics("damped", paper.BETA_S)
UNDAMPED = Physics("undamped", 0.0)


@dataclass(frozen=True)
class Setting:
    """What a program is asked; ``modes`` are the Krylov vectors of this program's reduced solid."""

    physics: Physics
    cells: tuple[int, int, int]
    its_s: float
    modes: int = MODES


@dataclass(frozen=True)
class Answer:
    """What came of a call: the quantities, and what they cost; or why there is nothing.

    ``further_s`` is what one more drop costs in the same process.
    """

    found: dict[str, float]
    wall_s: float = 0.0
    further_s: float | None = None
    peak_rss_MB: float = 0.0
    why_not: str = ""


@dataclass(frozen=True)
class Program:
    """A program of the table; ``model`` is that of this one, ``script`` a reference's.

    With ``fresh`` nothing that earlier processes stored of a body is there. ``physics`` are the
    names of what it can compute.
    """

    name: str
    model: str = ""
    script: str = ""
    fresh: bool = True
    physics: tuple[str, ...] = (DAMPED.name, UNDAMPED.name)

    def absent(self) -> str:
        """Why it cannot be run here; empty where it can."""
        if self.script and not (REFERENCES / self.script).exists():
            return "not here: reference programs are kept in the repository, in tests/reference"
        if self.script == "calculix.py" and shutil.which("ccx") is None:
            return "not installed: ccx is not on PATH"
        return ""

    def answer(self, setting: Setting, place: Bench, further: bool = False) -> Answer:
        """Run it once, as a process of its own; with ``further`` one of this program's is
        followed by a second process that makes one drop after another."""
        numbers: dict[str, Any] = {"its": setting.its_s, **setting.physics.numbers()}
        mesh = ["--cells", *map(str, setting.cells)]
        if self.script:
            return _reference(place, [str(REFERENCES / self.script), *options(numbers), *mesh])
        if self.fresh:
            place.forget()
        numbers |= {"modes": setting.modes}
        found = _own(place, [*options(numbers), *mesh, "--model", self.model])
        if found.why_not or not (further and self.fresh):
            return found
        again = call("jobs.further", model=self.model, cells=setting.cells, **numbers)
        done, cost = place.run(again)
        if cost.why_not:
            return cost
        return replace(found, further_s=json.loads(done.stdout.splitlines()[-1]))


PROGRAMS = (
    Program("bristle, solid", model="solid"),
    Program("bristle, reduced", model="reduced"),
    Program("bristle, reduced, kept", model="reduced", fresh=False),
    Program("bristle, beam", model="beam"),
    Program("dolfinx, naive", script="naive_dolfinx.py", physics=(DAMPED.name,)),
    Program("scipy, plain", script="plain_scipy.py"),
    Program("CalculiX", script="calculix.py", physics=(UNDAMPED.name,)),
)


class Bench:
    """Where processes run: a folder for their files and a cache of their own.

    The cache begins with what is compiled already, so that no program is charged for compiling.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._compiled = folder.joinpath("cache", *cache_folder().parts[-3:])
        ignore = shutil.ignore_patterns("arrays", "*.part")
        shutil.copytree(cache_folder(), self._compiled, ignore=ignore)

    def forget(self) -> None:
        """Drop what processes have stored of bodies."""
        shutil.rmtree(self._compiled / "arrays", ignore_errors=True)

    def environment(self) -> dict[str, str]:
        """That of a process which nobody launched as a rank, on one thread."""
        kept = unlaunched()
        package = str(Path(next(iter(bristle.__path__))).parent)
        path = os.pathsep.join(filter(None, (package, kept.get("PYTHONPATH", ""))))
        threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        cache = {"NUMBA_CACHE_DIR": str(self.folder / "cache")}
        return with_benchmarks({**kept, **threads, **cache, "PYTHONPATH": path})

    def run(self, arguments: list[str]) -> tuple[subprocess.CompletedProcess[str], Answer]:
        """Run the interpreter with ``arguments`` under `launch`, and say what it cost."""
        cost = self.folder / "cost.json"
        cost.unlink(missing_ok=True)
        launch = [sys.executable, "-I", "-S", str(Path(__file__).with_name("launch.py"))]
        with subprocess.Popen(
            [*launch, str(cost), sys.executable, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environment(),
            cwd=self.folder,
        ) as process:
            try:
                out, told = process.communicate()
            except BaseException:
                process.terminate()
                process.wait()
                raise
        done = subprocess.CompletedProcess(arguments, process.returncode, out, told)
        if done.returncode or not cost.exists():
            lines = (told.strip() or f"ended with status {done.returncode}").splitlines()
            return done, Answer({}, why_not=f"failed: {lines[-1]}")
        spent = json.loads(cost.read_text(encoding="utf-8"))
        return done, Answer({}, spent["wall_s"], None, spent["peak_rss_MB"])


def bench_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder that goes when the benchmark has ended."""
    return tempfile.TemporaryDirectory(prefix="bristle-bench-")


def _reference(place: Bench, arguments: list[str]) -> Answer:
    done, cost = place.run(arguments)
    if cost.why_not:
        return cost
    try:
        said = json.loads(done.stdout.splitlines()[-1])
        return replace(cost, found=_picked(said), further_s=said["wall_s"])
    except (IndexError, KeyError, ValueError):
        return Answer({}, why_not="failed: its last line is no result")


def _own(place: Bench, words: list[str]) -> Answer:
    """`bristle drop` as a user has it."""
    out = place.folder / "drop"
    drop = ["-m", "bristle.studies.cli", "drop", "--no-fields", *words]
    _, cost = place.run([*drop, "--out", str(out)])
    if cost.why_not:
        return cost
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    result["rebound_ratio"] = result["cm_rebound_ratio"]
    return replace(cost, found=_picked(result))


def _picked(said: dict[str, Any]) -> dict[str, float]:
    return {name: said[name] for name in (*QUANTITIES, "n_steps", "n_dofs")}
