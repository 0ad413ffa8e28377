"""Mutation testing: faults planted at random in meshes/ and solver/, and the tests that catch them.

    docker/run python3 tests/plant_faults.py --faults 20 --seed 1 --out results/faults

Each fault is planted in a copy of the repository with caches of its own, which are thrown away, and
the tests that everyone runs go through it up to the first failure, those nearest to the fault
first. A first clean run finds how long each test file takes, and tests that fail anyway, which are
left out; it is repeated for files that are new or changed. Records are kept as they come: called
again, the script goes on, and tries survivors once more where the tests have changed since.
"""

from __future__ import annotations

import argparse
import ast
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
from itertools import islice
from pathlib import Path

from mutants import Mutant, draw, mutants_of

ROOT = Path(__file__).absolute().parents[1]
MUTATED = ("meshes", "solver")
SOURCES = (*MUTATED, "studies")
NOT_COPIED = {".git", ".hypothesis", ".mypy_cache", ".ruff_cache", "build", "dist", "results"}
# A first test compiles, at times on a busy machine.
TEST_LIMIT_S = 1800
# Times what the clean run took, a run on a busier machine may take.
PATIENCE = 4.0
# Set where the script is interrupted: runs in threads end, and leave no record.
STOP = threading.Event()
SURVIVED = "SURVIVED"
FAILED = r"^(?:FAILED|ERROR) (\S+)"
PYTEST = (
    *("-m", "pytest", "-v", "-rfE", "--color=no", "--tb=short", "-p", "no:cacheprovider"),
    *("--hypothesis-seed=0", f"--timeout={TEST_LIMIT_S}"),
)


@dataclass(frozen=True)
class Clean:
    """How a test file runs without a fault: its text, its duration, the tests that fail."""

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
        clean = clean_run(out, scratch)
        records = read_records(out)
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
    for test in (test for each in clean.values() for test in each.failed):
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


def files(*folders: str) -> list[Path]:
    """The Python files of these folders of the repository."""
    return [path for each in folders for path in sorted((ROOT / each).rglob("*.py"))]


def digest(*paths: Path) -> str:
    """What these files hold."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()[:16]


# --- records ----------------------------------------------------------------------------------


def key(fault: Mutant) -> str:
    """A fault in the sources as they are now."""
    words = f"{digest(*files(*SOURCES))} {fault.path} {fault.start} {fault.end} {fault.new}"
    return hashlib.sha256(words.encode()).hexdigest()[:16]


def read_records(out: Path) -> dict[str, dict]:
    """Records by `key`, without survivors of other tests."""
    path = out / "records.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    records = {record["key"]: record for record in map(json.loads, lines)}
    tests = digest(*files("tests"))
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


def clean_run(out: Path, scratch: Path) -> dict[str, Clean]:
    """How each test file runs in the sources as they are.

    The forms that it compiles are left in ``out``: they are named after what they hold, so every
    fault may begin with them.
    """
    path, sources = out / "clean.json", digest(*files(*SOURCES))
    known = json.loads(path.read_text()) if path.exists() else {}
    tests = {
        each.relative_to(ROOT / "tests").as_posix(): digest(each)
        for each in sorted((ROOT / "tests").rglob("test_*.py"))
    }
    entries = known.get("files", {}) if known.get("sources") == sources else {}
    clean = {name: Clean(**entry) for name, entry in entries.items() if name in tests}
    changed = [name for name in tests if name not in clean or clean[name].digest != tests[name]]
    if changed:
        say(f"clean run of {len(changed)} test files …")
        with workplace(scratch, out) as place:
            report = place / "report.xml"
            more = f"--junit-xml={report}", "-o", "junit_family=xunit1", "--timeout-method=signal"
            status, output, _ = pytest(place, changed, math.inf, *more)
            (out / "logs" / "clean.txt").write_text(output)
            if status not in (0, 1):
                sys.exit(f"pytest ended with {status}, see {out / 'logs' / 'clean.txt'}")
            times = re.findall(r'file="tests/([^"]+)"[^>]* time="([^"]+)"', report.read_text())
            failed = re.findall(FAILED, output, re.M)
            for name in changed:
                clean[name] = Clean(
                    tests[name],
                    sum(float(seconds) for file, seconds in times if file == name),
                    [each for each in failed if each.startswith(f"tests/{name}")],
                )
            for folder in (place / "cache").rglob("forms-*"):
                shutil.copytree(folder, out / "forms" / folder.name, dirs_exist_ok=True)
        entries = {name: asdict(each) for name, each in clean.items()}
        path.write_text(json.dumps({"sources": sources, "files": entries}, indent=1))
    return clean


def tried(
    fault: Mutant, clean: dict[str, Clean], out: Path, scratch: Path, budget_s: float
) -> dict:
    """The record of a fault, also added to those in ``out``."""
    say(f"{fault.path}:{fault.line}: {fault.after}")
    patience_s = PATIENCE * sum(each.seconds for each in clean.values()) + TEST_LIMIT_S
    limit = min(patience_s, budget_s)
    left_out = [f"--deselect={test}" for each in clean.values() for test in each.failed]
    record = {"key": key(fault), "tests": digest(*files("tests")), **asdict(fault)}
    with workplace(scratch, out) as place:
        fault.plant(place / "copy")
        status, output, seconds = pytest(
            place, in_order(fault.path, clean), limit, "-x", "--timeout-method=thread", *left_out
        )
    found = caught_by(status, output)
    if status is None and budget_s < patience_s and found.startswith("timeout"):
        found = SURVIVED
    record |= {"caught_by": found, "seconds": seconds}
    (out / "logs" / f"{record['key']}.txt").write_text(output)
    with (out / "records.jsonl").open("a") as file:
        file.write(json.dumps(record) + "\n")
    say(f"{record['caught_by']}, {seconds:.0f} s")
    return record


@contextlib.contextmanager
def workplace(scratch: Path, out: Path) -> Iterator[Path]:
    """A folder with a copy of the repository, an own cache and own temporary files."""
    with tempfile.TemporaryDirectory(dir=scratch, ignore_cleanup_errors=True) as folder:
        place = Path(folder)
        shutil.copytree(ROOT, place / "copy", symlinks=True, ignore=not_copied)
        for name in ("cache/bristle", "tmp"):
            (place / name).mkdir(parents=True)
        if (out / "forms").exists():
            shutil.copytree(out / "forms", place / "cache" / "bristle", dirs_exist_ok=True)
        yield place


def not_copied(folder: str, names: list[str]) -> set[str]:
    """What running leaves in the repository, and its history."""
    return NOT_COPIED & set(names) if Path(folder) == ROOT else {"__pycache__"} & set(names)


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
        "PYTHONPYCACHEPREFIX": str(place / "cache" / "pycache"),
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


# --- order ------------------------------------------------------------------------------------


def in_order(mutated: str, clean: dict[str, Clean]) -> list[str]:
    """Test files, those first that reach the mutated one by few imports, then by duration."""
    links = {path: imports(path) for path in files(*SOURCES, "tests")}
    goal = ROOT / mutated

    def distance(name: str) -> int:
        seen, front, steps = set(), {ROOT / "tests" / name}, 0
        while front and goal not in front:
            seen |= front
            front = set().union(*(links[path] for path in front)) - seen
            steps += 1
        return steps if front else sys.maxsize

    return sorted(clean, key=lambda name: (distance(name), clean[name].seconds))


def imports(path: Path) -> set[Path]:
    """Files of the repository that one imports, anywhere in it."""
    here = path.relative_to(ROOT).with_suffix("").parts
    wanted: list[tuple[str, ...]] = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom):
            parts = tuple((node.module or "").split(".")) if node.module else ()
            stem = here[: len(here) - node.level] + parts if node.level else parts
            wanted += [stem, *((*stem, each.name) for each in node.names)]
        elif isinstance(node, ast.Import):
            wanted += [tuple(each.name.split(".")) for each in node.names]
    found = set()
    for parts in wanted:
        inside = parts[1:] if parts[:1] == ("bristle",) else parts
        for folder in (
            ROOT,
            ROOT / "tests",
            *(ROOT / "tests" / each for each in ("helpers", "reference")),
        ):
            found |= {folder.joinpath(*inside).with_suffix(".py")} if inside else set()
            found |= {folder.joinpath(*inside, "__init__.py")}
    return {each for each in found if each.is_file()}


def say(line: str) -> None:
    """A line of progress."""
    print(time.strftime("%H:%M:%S"), line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
