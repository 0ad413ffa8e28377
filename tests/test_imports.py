"""Imports of meshes/ and solver/ point one way: no two rooms, files or folders, in a circle."""

import ast
from pathlib import Path

import pytest

import bristle.solver

HERE = Path(next(iter(bristle.__path__)))


def room(module: tuple[str, ...]) -> str:
    """The file or folder of the first level below the package that a module lies in."""
    return "/".join(module[:2])


def imports(root: Path) -> dict[str, set[str]]:
    """Rooms that each room below ``root`` imports, whenever that be."""
    found: dict[str, set[str]] = {}
    for path in root.rglob("*.py"):
        module = (root.name, *path.relative_to(root).with_suffix("").parts)
        into = found.setdefault(room(module), set())
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = module[: len(module) - node.level]
                names = tuple(node.module.split(".")) if node.module else ()
                for alias in node.names:
                    into.add(room((*base, *names, alias.name)))
        into.discard(room(module))
    return {name: {other for other in into if other in found} for name, into in found.items()}


@pytest.mark.serial
@pytest.mark.parametrize("package", ["meshes", "solver"])
def test_no_two_rooms_import_each_other_in_a_circle(package):
    found = imports(HERE / package)
    assert len(found) > 5
    left = dict(found)
    while left:
        free = [name for name, into in left.items() if not into & left.keys()]
        assert free, f"in circles: { ({name: into & left.keys() for name, into in left.items()}) }"
        for name in free:
            del left[name]


def test_meshes_and_solver_know_nothing_of_studies():
    for package, allowed in (("meshes", {"meshes"}), ("solver", {"solver", "meshes"})):
        for path in (HERE / package).rglob("*.py"):
            depth = len(path.relative_to(HERE).parts)
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ImportFrom) and node.level == depth:
                    assert (node.module or "").split(".")[0] in allowed, path
