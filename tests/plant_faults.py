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
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
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
# Set where the script is interrupted: runs in threads end, and leave no record.
STOP = threading.Event()
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
    out: Path = arguments.out
    (out / "logs").mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        scratch = Path(folder)
        clean = clean_run(out, scratch, arguments.tests)
        records = read_records(out, clean)
        missing = [each for each in faults if key(each) not in records]
        with ThreadPoolExecutor(arguments.jobs) as pool:
            try:
                for record in pool.map(
                    lambda each: tried(each, clean, out, scratch, arguments.budget), missing
                ):
                    records[record["key"]] = record
            except BaseException:
                STOP.set()
                pool.shutdown(cancel_futures=True)
                raise
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
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="how many at once (1)")
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


def clean_run(out: Path, scratch: Path, part: str) -> dict[str, Clean]:
    """How each test file that begins with ``part`` runs in the sources as they are.

    What it compiles is left in ``out``.
    """
    sources, found = digest(*files(*SOURCES)), {}
    missing = {}
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        name = path.relative_to(ROOT / "tests").as_posix()
        if not name.startswith(part):
            continue
        kept = out / "clean" / f"{name}.json"
        known = Clean(**json.loads(kept.read_text())) if kept.exists() else None
        if known and (known.sources, known.digest) == (sources, digest(path)):
            found[name] = known
        else:
            missing[name] = kept, digest(path)
    if missing:
        with workplace(scratch, out) as place:
            try:
                for name, (kept, text) in missing.items():
                    say(f"clean run of {name} …")
                    found[name] = clean_file(name, sources, text, place, out)
                    kept.parent.mkdir(parents=True, exist_ok=True)
                    kept.write_text(json.dumps(asdict(found[name])))
            finally:
                keep_compiled(place, out)
    return found


def clean_file(name: str, sources: str, text: str, place: Path, out: Path) -> Clean:
    """Run a test file."""
    status, output, seconds = pytest(place, [name], math.inf, "--timeout=1800")
    if status not in (0, 1, 5):
        log = out / "logs" / "clean.txt"
        log.write_text(output)
        sys.exit(f"pytest ended with {status}, see {log}")
    return Clean(sources, text, seconds, re.findall(FAILED, output, re.M))


def tried(
    fault: Mutant, clean: dict[str, Clean], out: Path, scratch: Path, budget_s: float
) -> dict:
    """The record of a fault, also added to those in ``out``."""
    say(f"{fault.path}:{fault.line}: {fault.after}")
    names = in_order(fault.path, clean)
    patience_s = PATIENCE * sum(clean[name].seconds for name in names) + TEST_LIMIT_S
    left_out = [f"--deselect={test}" for name in names for test in clean[name].failed]
    record = {"key": key(fault), "tests": tests_of(clean), **asdict(fault)}
    status, output, spent_s = 0, "no test reaches it", 0.0
    if names:
        with workplace(scratch, out, fault) as place:
            more = "-x", f"--timeout={TEST_LIMIT_S}", "--timeout-method=thread", *left_out
            status, output, spent_s = pytest(place, names, min(patience_s, budget_s), *more)
    found = caught_by(status, output)
    if status is None and budget_s < patience_s and found.startswith("timeout"):
        found = SURVIVED
    record |= {"caught_by": found, "seconds": spent_s, "test_files": len(names)}
    (out / "logs" / f"{record['key']}.txt").write_text(output)
    with (out / "records.jsonl").open("a") as file:
        file.write(json.dumps(record) + "\n")
    say(f"{record['caught_by']}, {spent_s:.0f} s")
    return record


@contextlib.contextmanager
def workplace(scratch: Path, out: Path, fault: Mutant | None = None) -> Iterator[Path]:
    """A folder with a copy of the repository, an own cache and own temporary files."""
    with tempfile.TemporaryDirectory(dir=scratch, ignore_cleanup_errors=True) as folder:
        place = Path(folder)
        # with the times of the files, by which Python knows what it has compiled
        shutil.copytree(ROOT, place / "copy", symlinks=True, ignore=not_copied)
        if fault:
            fault.plant(place / "copy")
        for name in ("cache/bristle", "tmp"):
            (place / name).mkdir(parents=True)
        take_compiled(place, out, fault)
        yield place


def not_copied(folder: str, names: list[str]) -> set[str]:
    """What running leaves in the repository, and its history."""
    return NOT_COPIED & set(names) if Path(folder) == ROOT else {"__pycache__"} & set(names)


def compiled_folder(place: Path) -> Path:
    """Where a copy has what Numba compiles of it."""
    version = version_of(place / "copy" / "solver")
    return place / "cache" / "bristle" / f"compiled-{os.getuid()}" / version


def keep_compiled(place: Path, out: Path) -> None:
    """Leave in ``out`` what was compiled in a copy without a fault.

    Forms are named after what they hold, so every fault may begin with them.
    """
    if compiled_folder(place).exists():
        shutil.copytree(compiled_folder(place), out / "compiled", dirs_exist_ok=True)
    for kept in (place / "cache").rglob("forms-*"):
        shutil.copytree(kept, out / "forms" / kept.name, dirs_exist_ok=True)


def take_compiled(place: Path, out: Path, fault: Mutant | None) -> None:
    """Give a copy what was kept, but for what is compiled from the mutated file.

    Numba looks at a function's own file alone to see whether it is stale, and its code holds that
    of the functions that it calls: files that import the mutated one are compiled anew, too.
    """
    stale = importers(ROOT / fault.path) if fault else set()
    kept = out / "compiled"

    def of_stale_files(folder: str, names: list[str]) -> set[str]:
        source = ROOT / "solver" / Path(folder).relative_to(kept)
        begins = tuple(f"{path.stem}." for path in stale if path.parent == source)
        return {name for name in names if name.startswith(begins)}

    if kept.exists():
        shutil.copytree(kept, compiled_folder(place), ignore=of_stale_files)
    if (out / "forms").exists():
        shutil.copytree(out / "forms", place / "cache" / "bristle", dirs_exist_ok=True)


def pytest(
    place: Path, names: list[str], limit_s: float, *more: str
) -> tuple[int | None, str, float]:
    """Status, output and seconds of the test files ``names``, run in this order in a copy.

    The status is None where they take longer than ``limit_s``.
    """
    live = place / "copy" / "docker" / "live"
    environment = {
        **os.environ,
        "PATH": f"{live / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": str(live),
        "PYTHONPYCACHEPREFIX": str(place.parent / "pycache"),
        "XDG_CACHE_HOME": str(place / "cache"),
        "TMPDIR": str(place / "tmp"),
    }
    environment.pop("NUMBA_CACHE_DIR", None)
    started = time.monotonic()
    with (place / "output").open("w+") as output:
        process = subprocess.Popen(
            [sys.executable, *PYTEST, *more, *(f"tests/{name}" for name in names)],
            cwd=place / "copy",
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            while (status := process.poll()) is None and time.monotonic() - started < limit_s:
                if STOP.wait(0.2):
                    raise CancelledError
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
