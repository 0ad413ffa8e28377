"""Mutation testing: faults planted at random in meshes/ and solver/, and the tests that catch them.

    docker/run python3 tests/plant_faults.py --faults 20 --seed 1 --out results/faults

Each fault is planted in a copy of the repository, and the tests that everyone runs go through it up
to the first failure: the test files from which imports lead to the fault (`reach`), the nearest
first. A first clean run, a process for each test file, finds how long it takes and which of its
tests fail anyway and are left out; it is repeated for files that are new or changed, and for all
where the sources have. What it compiles is taken over, but for files that import the mutated one.
Records are kept as they come: called again, the script goes on, and tries survivors once more where
the tests have changed since.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import chain, islice
from pathlib import Path

from mutants import Mutant, draw, mutants_of
from reach import ROOT, SOURCES, files, importers, in_order

from bristle.solver.compiled import version_of

MUTATED = ("meshes", "solver")
NOT_COPIED = {".git", ".hypothesis", ".mypy_cache", ".ruff_cache", "build", "dist", "results"}
# For a test. It may compile, at times on a busy machine.
TEST_LIMIT_S = 600
# Times what the clean run took, a run on a busier machine may take.
PATIENCE = 4.0
SURVIVED = "SURVIVED"
FAILED = r"^(?:FAILED|ERROR) (\S+)"
PYTEST = (
    *("-m", "pytest", "-n", "0", "-v", "-rfE", "--color=no", "--tb=short"),
    *("-p", "no:cacheprovider", "--hypothesis-seed=0"),
)


@dataclass(frozen=True)
class Clean:
    """How a test file runs without a fault: ``sources`` and ``digest`` name the program and the
    file that ran, ``failed`` are the tests that fail anyway."""

    sources: str
    digest: str
    seconds: float
    failed: list[str]


def main() -> None:
    """Draw faults, try those that have no record, and print all of them."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    arguments = parsed()
    paths = [ROOT / arguments.only] if arguments.only else files(*MUTATED)
    mutants = [each for path in paths for each in mutants_of(ROOT, path)]
    faults = list(islice(draw(mutants, arguments.seed), arguments.faults))
    if arguments.list:
        print(*(described(asdict(each)) for each in faults), sep="\n")
        return
    place = Place(arguments.out.absolute())
    clean = place.clean_run(arguments.tests)
    records = read_records(arguments.out, clean)
    for fault in faults:
        if key(fault) not in records:
            records[key(fault)] = place.tried(fault, clean, arguments.budget)
    print(table([records[key(each)] for each in faults]))
    for test in chain.from_iterable(each.failed for each in clean.values()):
        print(f"left out, since it fails without a fault: {test}")


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--faults", type=int, default=20, metavar="N", help="how many (20)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="which (0)")
    parser.add_argument("--only", metavar="FILE", help="in this file alone, as solver/fall.py")
    parser.add_argument("--tests", metavar="PART", default="", help="alone, as solver/test_fall")
    parser.add_argument(
        "--budget",
        metavar="SECONDS",
        type=float,
        default=math.inf,
        help="of tests for each fault; one that none has caught by then counts as survived",
    )
    parser.add_argument("--list", action="store_true", help="only print the faults")
    parser.add_argument(
        *("--out", "-o"), type=Path, default=ROOT / "results" / "faults", metavar="DIR"
    )
    return parser.parse_args()


def digest(*paths: Path) -> str:
    """What these files hold."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:16]


# --- records ----------------------------------------------------------------------------------


def key(fault: Mutant) -> str:
    """A fault in the sources as they are now."""
    words = f"{digest(*files(*SOURCES))} {fault.path} {fault.start} {fault.end} {fault.new}"
    return hashlib.sha256(words.encode()).hexdigest()[:16]


def tests_of(clean: dict[str, Clean]) -> str:
    """What the tests are that faults go through."""
    helpers = [path for path in files("tests") if not path.name.startswith("test_")]
    return digest(*helpers, *(ROOT / "tests" / name for name in clean))


def read_records(out: Path, clean: dict[str, Clean]) -> dict[str, dict]:
    """Records by `key`, without survivors of other tests."""
    path = out / "records.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    records = {record["key"]: record for record in map(json.loads, lines)}
    tests = tests_of(clean)
    return {
        name: record
        for name, record in records.items()
        if record["caught_by"] != SURVIVED or record["tests"] == tests
    }


def described(record: dict) -> str:
    """Where a fault is, and the line without and with it."""
    where = f"{record['path']}:{record['line']}  {record['kind']}"
    return f"{where}\n    - {record['before']}\n    + {record['after']}"


def table(records: list[dict]) -> str:
    """Records as lines of text, and how many were caught."""
    lines = [
        f"{described(each)}\n    {each['caught_by']}, {each['seconds']:.0f} s" for each in records
    ]
    caught = sum(each["caught_by"] != SURVIVED for each in records)
    late = sum(each["caught_by"].startswith("timeout") for each in records)
    return "\n".join([*lines, f"caught {caught}/{len(records)}, {late} of them by a timeout"])


# --- runs -------------------------------------------------------------------------------------


class Place:
    """A copy of the repository in the folder ``out``, with a cache and temporary files of its own,
    in which faults are planted."""

    def __init__(self, out: Path) -> None:
        self.out, self.copy, self.cache = out, out / "copy", out / "cache" / "bristle"
        for made in (out / "logs", out / "tmp", self.cache):
            made.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(self.copy, ignore_errors=True)
        # with the times of the files, by which Python knows what it has compiled
        shutil.copytree(ROOT, self.copy, symlinks=True, ignore=self.not_copied)

    def not_copied(self, folder: str, names: list[str]) -> set[str]:
        """What running leaves in the repository, and its history."""
        left_out = NOT_COPIED if Path(folder) == ROOT else {"__pycache__"}
        return {name for name in names if name in left_out or Path(folder, name) == self.out}

    def clean_run(self, part: str) -> dict[str, Clean]:
        """How each test file that begins with ``part`` runs in the sources as they are."""
        sources, found = digest(*files(*SOURCES)), {}
        for path in sorted((ROOT / "tests").rglob("test_*.py")):
            name = path.relative_to(ROOT / "tests").as_posix()
            kept = self.out / "clean" / f"{name}.json"
            if not name.startswith(part):
                continue
            known = Clean(**json.loads(kept.read_text())) if kept.exists() else None
            if known is None or (known.sources, known.digest) != (sources, digest(path)):
                say(f"clean run of {name} …")
                status, output, seconds = self.pytest([name], math.inf, "--timeout=1800")
                if status not in (0, 1, 5):
                    (self.out / "logs" / "clean.txt").write_text(output)
                    sys.exit(f"pytest ended with {status}, see {self.out / 'logs' / 'clean.txt'}")
                known = Clean(sources, digest(path), seconds, re.findall(FAILED, output, re.M))
                kept.parent.mkdir(parents=True, exist_ok=True)
                kept.write_text(json.dumps(asdict(known)))
            found[name] = known
        return found

    def tried(self, fault: Mutant, clean: dict[str, Clean], budget_s: float) -> dict:
        """The record of a fault, also added to those in ``out``."""
        say(f"{fault.path}:{fault.line}: {fault.after}")
        names = in_order(fault.path, clean)
        patience_s = PATIENCE * sum(clean[name].seconds for name in names) + TEST_LIMIT_S
        left_out = [f"--deselect={test}" for name in names for test in clean[name].failed]
        record = {"key": key(fault), "tests": tests_of(clean), **asdict(fault)}
        more = "-x", f"--timeout={TEST_LIMIT_S}", "--timeout-method=thread", *left_out
        status, output, spent_s = 0, "no test reaches it", 0.0
        if names:
            with self.planted(fault):
                status, output, spent_s = self.pytest(names, min(patience_s, budget_s), *more)
        found = caught_by(status, output)
        if status is None and budget_s < patience_s and found.startswith("timeout"):
            found = SURVIVED
        record |= {"caught_by": found, "seconds": spent_s, "test_files": len(names)}
        (self.out / "logs" / f"{record['key']}.txt").write_text(output)
        with (self.out / "records.jsonl").open("a") as file:
            file.write(json.dumps(record) + "\n")
        say(f"{record['caught_by']}, {spent_s:.0f} s")
        return record

    @contextlib.contextmanager
    def planted(self, fault: Mutant) -> Iterator[None]:
        """The fault is in the copy; what is compiled from the mutated file is not known.

        Numba looks at a function's own file alone to see whether it is stale, and its code holds
        that of the functions that it calls: files that import the mutated one are compiled anew,
        too. Forms are named after what they hold, so every fault may begin with them.
        """
        stale, kept = importers(ROOT / fault.path), self.compiled()

        def of_stale_files(folder: str, names: list[str]) -> set[str]:
            source = ROOT / "solver" / Path(folder).relative_to(kept)
            begins = tuple(f"{path.stem}." for path in stale if path.parent == source)
            return {name for name in names if name.startswith(begins)}

        fault.plant(self.copy)
        own = self.compiled()
        if own != kept and kept.exists():
            shutil.copytree(kept, own, ignore=of_stale_files, dirs_exist_ok=True)
        try:
            yield
        finally:
            shutil.copy2(ROOT / fault.path, self.copy / fault.path)
            if own != kept:
                shutil.rmtree(own, ignore_errors=True)

    def compiled(self) -> Path:
        """Where the copy as it is has what Numba compiles of it."""
        return self.cache / f"compiled-{os.getuid()}" / version_of(self.copy / "solver")

    def pytest(self, names: list[str], limit_s: float, *more: str) -> tuple[int | None, str, float]:
        """Status, output and seconds of the test files ``names``, run in this order in the copy.

        The status is None where they take longer than ``limit_s``.
        """
        live = self.copy / "docker" / "live"
        environment = {
            **os.environ,
            "PATH": f"{live / 'bin'}:{os.environ['PATH']}",
            "PYTHONPATH": str(live),
            "PYTHONPYCACHEPREFIX": str(self.out / "pycache"),
            "XDG_CACHE_HOME": str(self.cache.parent),
            "TMPDIR": str(self.out / "tmp"),
        }
        environment.pop("NUMBA_CACHE_DIR", None)
        started = time.monotonic()
        with (self.out / "output").open("w+") as output:
            process = subprocess.Popen(
                [sys.executable, *PYTEST, *more, *(f"tests/{name}" for name in names)],
                cwd=self.copy,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                status = process.wait(None if math.isinf(limit_s) else limit_s)
            except subprocess.TimeoutExpired:
                status = None
            finally:
                end_session(process.pid)
                process.wait()
            output.seek(0)
            return status, output.read(), time.monotonic() - started


def end_session(leader: int) -> None:
    """Kill a process and what its tests have left running, ranks of MPI among it."""
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(ProcessLookupError):
            if os.getsid(int(path.name)) == leader:
                os.kill(int(path.name), signal.SIGKILL)


def caught_by(status: int | None, output: str) -> str:
    """The test that failed, was too slow or ended the process."""
    if status == 0:
        return SURVIVED
    if failed := re.search(FAILED, output, re.M):
        return failed[1]
    last = re.findall(r"^(tests/\S+::\S+)", output, re.M)
    where = last[-1] if last else "collection"
    if status is None or "+ Timeout +" in output:
        return f"timeout in {where}"
    return f"status {status} in {where}"


def say(line: str) -> None:
    """A line of progress."""
    print(time.strftime("%H:%M:%S"), line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
