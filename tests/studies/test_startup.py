"""A command loads only what it needs, since every call waits for it."""

from __future__ import annotations

import json

import pytest
from commands import python

from bristle.studies.cli import app

pytestmark = pytest.mark.serial

MESHED = {"dolfinx", "ufl", "basix", "ffcx", "petsc4py", "gmsh", "meshio", "adios2"}
PAGES = {"matplotlib", "pyvista", "vtkmodules", "jinja2", "PIL", "imageio"}
STATISTICS = {"pandas", "statsmodels"}
NUMERICS = {"numpy", "scipy", "numba", "mpi4py"}
COMMANDS = list(app.commands)

CODE = """
import json, sys
from bristle.studies.cli import main
status = main(sys.argv[1:])
print(json.dumps([status, sorted({name.partition('.')[0] for name in sys.modules})]))
"""


def loaded(*arguments: object) -> tuple[int, set[str]]:
    """Exit status of a command, and the packages that its process has loaded at the end."""
    # cold, compiled code takes its time
    result = python("-c", CODE, *arguments, timeout_s=500.0)
    status, names = json.loads(result.stdout.splitlines()[-1])
    return status, set(names)


def test_the_names_are_those_of_packages() -> None:
    # a name that nothing has could not be found loaded
    from importlib.util import find_spec

    for name in MESHED | PAGES | STATISTICS | NUMERICS:
        assert find_spec(name) is not None, name


def test_help_loads_no_numerics() -> None:
    """One process for all, as what one of them loads stays for the next."""
    calls = [[], ["--version"], ["--help"], *([name, "--help"] for name in COMMANDS)]
    code = CODE.replace("status = main(sys.argv[1:])", f"status = [main(call) for call in {calls}]")
    result = python("-c", code)
    statuses, names = json.loads(result.stdout.splitlines()[-1])
    assert statuses == [0] * len(calls)
    assert not set(names) & (MESHED | PAGES | STATISTICS | NUMERICS)


@pytest.mark.parametrize("arguments", [("drop", "--hight", "1"), ("swep",), ("calibrate",)])
def test_a_wrong_command_line_loads_no_numerics(arguments: tuple[str, ...]) -> None:
    status, names = loaded(*arguments)
    assert status == 2
    assert not names & (MESHED | PAGES | STATISTICS | NUMERICS)


def test_a_wrong_value_loads_nothing_that_computes_a_solid() -> None:
    status, names = loaded("drop", "--model", "solid", "--kn", -1)
    assert status == 2
    assert not names & (MESHED | PAGES | STATISTICS)


@pytest.mark.parametrize("model", ["analytic", "beam"])
def test_a_drop_without_a_mesh_loads_no_finite_elements(model: str, tmp_path) -> None:
    status, names = loaded("drop", "--model", model, "--out", tmp_path / "drop")
    assert status == 0
    assert "numba" in names
    assert not names & (MESHED | PAGES | STATISTICS | {"mpi4py"})


def test_compiled_code_is_read_without_what_compiles(tmp_path) -> None:
    # the second of two alike finds all of it on disk
    code = CODE.replace("name.partition('.')[0]", "name")
    drop = ("drop", "--model", "beam", "--out", tmp_path / "drop")
    for _ in range(2):
        result = python("-c", code, *drop, timeout_s=500.0)
    status, names = json.loads(result.stdout.splitlines()[-1])
    assert status == 0
    assert "numba.core.dispatcher" in names
    assert not {"numba.typed.typedlist", "numba.np.random.generator_methods"} & set(names)


def test_a_sweep_of_beams_loads_no_finite_elements(tmp_path) -> None:
    arguments = ("--models", "beam", "--kn", "2e6", "--heights", "0.05", "--out", tmp_path / "s")
    status, names = loaded("sweep", *arguments)
    assert status == 0
    assert not names & (MESHED | STATISTICS)


def test_a_loop_that_needs_no_solid_loads_none(tmp_path) -> None:
    status, names = loaded("close-loop", tmp_path / "nowhere")
    assert status == 2
    assert not names & (MESHED | PAGES | STATISTICS)
