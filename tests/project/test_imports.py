"""Imports point one way: no two rooms, files or folders of a package, in a circle."""

import ast
import re
from pathlib import Path

import pytest

import bristle.solver

HERE = Path(next(iter(bristle.__path__)))


def imports(root: Path) -> dict[str, set[str]]:
    """Rooms, files or folders just below ``root``, that each of them imports, whenever that be."""
    found: dict[str, set[str]] = {}
    for path in root.rglob("*.py"):
        module = path.relative_to(root).with_suffix("").parts
        into = found.setdefault(module[0], set())
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and 0 < node.level <= len(module):
                names = node.module.split(".") if node.module else []
                base = (*module[: len(module) - node.level], *names)
                into |= {base[0]} if base else {alias.name for alias in node.names}
        into.discard(module[0])
    return {name: {other for other in into if other in found} for name, into in found.items()}


@pytest.mark.serial
@pytest.mark.parametrize(
    ("package", "least"),
    [
        ("meshes", 8),
        ("solver", 20),
        ("studies", 15),
        ("studies/loop", 15),
        ("studies/loop/kinds", 4),
    ],
)
def test_no_two_rooms_import_each_other_in_a_circle(package, least):
    found = imports(HERE / package)
    assert len(found) > least
    left = dict(found)
    while left:
        free = [name for name, into in left.items() if not into & left.keys()]
        assert free, f"in circles: { ({name: into & left.keys() for name, into in left.items()}) }"
        for name in free:
            del left[name]


def modules() -> dict[str, set[str]]:
    """Every module with those that it imports, whenever that be and if for a type checker alone."""
    every = {
        ".".join(path.relative_to(HERE).with_suffix("").parts): path
        for room in ("meshes", "solver", "studies")
        for path in (HERE / room).rglob("*.py")
    }
    found: dict[str, set[str]] = {}
    for module, path in every.items():
        tree, into = ast.parse(path.read_text()), set()
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = module.split(".")[: -node.level] + (node.module or "").split(".")
                name = ".".join(filter(None, base))
                into |= {f"{name}.{alias.name}" for alias in node.names} | {name}
        found[module] = into & every.keys() - {module}
    return found


@pytest.mark.serial
def test_no_modules_import_each_other_in_a_circle():
    left = modules()
    assert len(left) > 200
    while left:
        free = [name for name, into in left.items() if not into & left.keys()]
        assert free, f"in circles, or on the way to one: {sorted(left)}"
        for name in free:
            del left[name]


@pytest.mark.parametrize(
    ("package", "allowed"),
    [("meshes", {"meshes"}), ("solver", {"solver", "meshes"})],
)
def test_meshes_and_solver_know_nothing_of_studies(package, allowed):
    for path in (HERE / package).rglob("*.py"):
        depth = len(path.relative_to(HERE).parts)
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level == depth:
                assert (node.module or "").split(".")[0] in allowed, path


@pytest.mark.parametrize("package", ["meshes", "solver"])
def test_meshes_and_solver_know_no_options_of_the_command_line(package):
    """An error has the names of inputs instead, see solver.errors."""
    for path in (HERE / package).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert not re.search(r"(^|\W)--[a-z]", node.value), f"{path}:{node.lineno}"


@pytest.mark.parametrize(
    ("room", "below"),
    [
        ("inputs", set()),
        ("running", {"inputs"}),
        ("data", {"inputs"}),
        ("report", {"running"}),
        ("command", {"inputs", "running"}),
        ("loop", {"inputs", "data", "running"}),
    ],
)
def test_what_studies_stand_on_knows_no_study(room, below):
    assert imports(HERE / "studies")[room] <= below
