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


@pytest.mark.parametrize(
    ("words", "status", "unused"),
    [
        *((each, 2, MESHED | PAGES | STATISTICS | NUMERICS)
          for each in ("drop --hight 1", "swep", "calibrate")),
        ("drop --model solid --kn -1", 2, MESHED | PAGES | STATISTICS),
        *((f"drop --model {model} --out OUT", 0, MESHED | PAGES | STATISTICS | {"mpi4py"})
          for model in ("analytic", "beam")),
        ("sweep --models beam --kn 2e6 --heights 0.05 --out OUT", 0, MESHED | STATISTICS),
        ("close-loop OUT", 2, MESHED | PAGES | STATISTICS),
    ],
)  # fmt: skip
def test_a_command_loads_what_it_needs_alone(words, status, unused, tmp_path) -> None:
    """Nothing where the words are wrong, no finite elements where no solid is computed."""
    arguments = words.replace("OUT", str(tmp_path / "nowhere")).split()
    # cold, compiled code takes its time
    result = python("-c", CODE, *arguments, timeout_s=500.0)
    ended, names = json.loads(result.stdout.splitlines()[-1])
    assert ended == status
    assert not set(names) & unused
    assert ("numba" in names) or status


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
