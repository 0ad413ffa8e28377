"""Which test files can reach a fault, from what their tests execute and what they import."""

from __future__ import annotations

import ast
import re
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from mutants import Mutant

ROOT = Path(__file__).absolute().parents[1]
SOURCES = ("meshes", "solver", "studies")
# Where a file has functions that run compiled, and so unseen.
COMPILED = re.compile(r"^@(njit|inlined|fast)\b|\b(Pointer|Kind\.of)\(", re.M)


@dataclass(frozen=True)
class Clean:
    """How a test file runs without a fault.

    ``sources`` and ``digest`` name the program and the file that ran, ``seconds`` each test takes,
    ``failed`` are those that do so anyway; ``lines`` holds, for each line of a function in each
    file of the program, the tests that execute it, by their places in ``seconds``; -1 is all.
    """

    sources: str
    digest: str
    seconds: dict[str, float]
    failed: list[str]
    lines: dict[str, dict[str, list[int]]]

    def executing(self, path: str, lines: range) -> set[str]:
        """The tests that execute any of the lines of a file."""
        names, there = list(self.seconds), self.lines.get(path, {})
        places = {place for line in lines for place in there.get(str(line), ())}
        return set(names) if -1 in places else {names[place] for place in places}


def in_order(fault: Mutant, clean: dict[str, Clean]) -> tuple[list[str], set[str]]:
    """The test files that can reach a fault, nearest first, and the tests that execute it.

    All tests of a file are there where one executes the statement, since what that one has computed
    may be kept for the others. A fault outside of functions, or in a file with compiled ones, is
    reached by whatever executes a function of a file that imports it, or that imports a file of
    compiled functions through which it may be called.
    """
    lines = statement_lines(ROOT / fault.path, fault.line)
    unseen = lines is None or is_compiled(ROOT / fault.path)
    near = importers(ROOT / fault.path, within=is_compiled)
    near |= {path for path, found in links().items() if near & found}
    first: set[str] = set()
    reaching = {}
    for name, run in clean.items():
        executing = run.executing(fault.path, lines) if lines else set()
        files_run = {ROOT / path for path in run.lines} | with_helpers(ROOT / "tests" / name)
        if executing or (unseen and near & files_run):
            first |= executing
            seconds = sum(run.seconds[test] for test in executing or run.seconds)
            reaching[name] = (not executing, distance(name, ROOT / fault.path), seconds)
    return sorted(reaching, key=lambda name: reaching[name]), first


def statement_lines(path: Path, line: int) -> range | None:
    """Of the innermost statement in a function that has this line; None outside of functions.

    Of one that holds others, its head alone.
    """
    found: range | None = None

    def look(node: ast.AST, *, inside: bool) -> None:
        nonlocal found
        inside = inside or isinstance(node, ast.FunctionDef)
        for each in ast.iter_child_nodes(node):
            if isinstance(each, ast.stmt) and each.lineno <= line <= (each.end_lineno or 0):
                body = getattr(each, "body", None)
                end = max(body[0].lineno, each.lineno + 1) if body else (each.end_lineno or 0) + 1
                if inside and line < end:
                    found = range(each.lineno, end)
            look(each, inside=inside)

    look(ast.parse(path.read_bytes()), inside=False)
    return found


def distance(name: str, goal: Path) -> int:
    """Imports from a test file to a file of the program."""
    seen: set[Path] = set()
    front, steps = {ROOT / "tests" / name}, 0
    while front and goal not in front:
        seen |= front
        front = set().union(*(links()[path] for path in front)) - seen
        steps += 1
    return steps if front else sys.maxsize


def with_helpers(path: Path) -> set[Path]:
    """A test file and what it imports of tests/."""
    found, front = set(), {path}
    while front:
        found |= front
        front = set().union(*(links()[each] for each in front)) - found
        front = {each for each in front if (ROOT / "tests") in each.parents}
    return found


def importers(path: Path, within=lambda path: True) -> set[Path]:
    """A file, and those that import it, directly or through others of these."""
    found, front = set(), {path}
    while front:
        found |= front
        front = {each for each, there in links().items() if front & there and within(each)} - found
    return found


def files(*folders: str) -> list[Path]:
    """The Python files of these folders of the repository."""
    return [path for each in folders for path in sorted((ROOT / each).rglob("*.py"))]


@cache
def is_compiled(path: Path) -> bool:
    """Whether a file has functions that Numba compiles."""
    return COMPILED.search(path.read_text()) is not None


@cache
def links() -> dict[Path, set[Path]]:
    """What each file of the program and its tests imports of these."""
    return {path: imports(path) for path in files(*SOURCES, "tests")}


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
