"""Imports point one way: no two rooms, files or folders of a package, in a circle."""

import ast
import re
from collections.abc import Hashable

import pytest
from reach import ROOT, SOURCES, files, links

pytestmark = pytest.mark.serial


def rooms(package: str) -> dict[str, set[str]]:
    """Files or folders of a package that each of them imports, whenever that be."""
    root, found = ROOT / package, {}
    for path in files(package):
        each, *into = (
            other.relative_to(root).parts[0].removesuffix(".py")
            for other in (path, *links()[path])
            if other.is_relative_to(root)
        )
        found.setdefault(each, set()).update({*into} - {each, "__init__"})
    return found


def assert_no_circle[T: Hashable](left: dict[T, set[T]]) -> None:
    while left:
        free = [name for name, into in left.items() if not into & left.keys()]
        assert free, f"in circles, or on the way to one: {sorted(map(str, left))}"
        for name in free:
            del left[name]


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
    found = rooms(package)
    assert len(found) > least
    assert_no_circle(found)


def test_no_modules_import_each_other_in_a_circle():
    """Those for a type checker alone count, too."""
    every = files(*SOURCES)
    assert len(every) > 200
    assert_no_circle({path: links()[path].intersection(every) - {path} for path in every})


@pytest.mark.parametrize(
    ("package", "allowed"),
    [("meshes", {"meshes"}), ("solver", {"solver", "meshes"})],
)
def test_meshes_and_solver_know_nothing_of_studies(package, allowed):
    for path in files(package):
        into = {each.relative_to(ROOT).parts[0] for each in links()[path]}
        assert into <= allowed, path


@pytest.mark.parametrize("package", ["meshes", "solver"])
def test_meshes_and_solver_know_no_options_of_the_command_line(package):
    """An error has the names of inputs instead, see solver.errors."""
    for path in files(package):
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
    assert rooms("studies")[room] <= below
