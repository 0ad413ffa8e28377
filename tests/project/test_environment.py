"""The environment is what the lists of packages say, and docker/run passes everything on."""

import ast
import os
import re
import shutil
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"
RUN = str(DOCKER / "run")
ON_DEBIAN = shutil.which("dpkg-query") is not None and Path("/etc/bristle-environment").exists()

# an MPI rank's children would take its place in the job
pytestmark = pytest.mark.serial


LISTS = ("packages", "packages-develop")


def package_list(name: str) -> list[str]:
    lines = (DOCKER / name).read_text().splitlines()
    return [package for line in lines if (package := line.partition("#")[0].strip())]


def dockerfile_variables() -> dict[str, str]:
    lines = (DOCKER / "Dockerfile").read_text().partition("FROM environment")[0].splitlines()
    return dict(
        line.removeprefix("ENV ").split("=", 1) for line in lines if line.startswith("ENV ")
    )


def numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text)[:2])


def run(*command: str, **options) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [RUN, *command], capture_output=True, text=True, timeout=120, check=False, **options
    )


@pytest.mark.parametrize(
    ("distribution", "oldest"),
    [
        ("fenics-dolfinx", (0, 9)),
        ("petsc4py", (3, 22)),
        ("mpi4py", (4, 0)),
        ("meshio", (5, 3)),
        ("pyvista", (0, 44)),
        ("numpy", (2, 0)),
        ("scipy", (1, 14)),
        ("numba", (0, 60)),
        ("pydantic", (2, 0)),
    ],
)
def test_versions(distribution: str, oldest: tuple[int, int]) -> None:
    assert numbers(version(distribution)) >= oldest


def test_blas_is_openblas() -> None:
    # PETSc and numpy both reach it through libblas.so.3, whichever package provides that
    code = (
        "import numpy; from petsc4py import PETSc; a = numpy.eye(2) @ numpy.eye(2);"
        "print(open('/proc/self/maps').read())"
    )
    maps = run(sys.executable, "-c", code).stdout
    blas = {line.split()[-1] for line in maps.splitlines() if "libblas" in line}
    assert "libopenblas" in maps
    assert all("openblas" in os.path.realpath(library) for library in blas), blas


@pytest.mark.skipif(not ON_DEBIAN, reason="asks dpkg what the image or the tree holds")
def test_every_listed_package_is_installed() -> None:
    listed = [package for name in LISTS for package in package_list(name)]
    query = subprocess.run(
        ["dpkg-query", "--show", "--showformat=${Package} ${db:Status-Status}\n", *listed],
        capture_output=True,
        text=True,
        check=False,
    )
    installed = {
        line.split()[0] for line in query.stdout.splitlines() if line.endswith(" installed")
    }
    assert not set(listed) - installed, query.stderr


def test_image_and_tree_are_made_from_the_lists() -> None:
    dockerfile = (DOCKER / "Dockerfile").read_text()
    first, further = (set(package_list(name)) for name in LISTS)
    assert not first & further
    assert len(first) > 20
    assert len(further) > 5
    for name in LISTS:
        assert f"COPY docker/{name} /tmp/packages\n" in dockerfile
    for package in first | further:
        own_name = rf"(?<![\w/-]){re.escape(package)}(?![\w-])"
        lists = [line for line in dockerfile.splitlines() if "apt-get install" in line]
        assert not re.search(own_name, "\n".join(lists).replace("xargs", "")), package


# What Debian calls the package of a module, where that is not python3- and the module.
PACKAGES = {"PIL": "python3-pil", "gmsh": "python3-gmsh", "pydantic_core": "python3-pydantic-core"}


def test_the_first_list_has_what_the_product_imports_and_no_other_module() -> None:
    imported = set()
    for room in ("meshes", "solver", "studies"):
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    imported |= {alias.name.split(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                    imported.add(node.module.split(".")[0])
    # the script that a result brings for ParaView is run by ParaView
    imported -= sys.stdlib_module_names | {"paraview", "bristle", "vtkmodules"}
    needed = {PACKAGES.get(name, f"python3-{name}") for name in imported}
    listed = {name for name in package_list("packages") if name.startswith("python3-")}
    # compilers of forms need the headers and setuptools, pyvista a VTK, the image is made by pip
    others = ("dev", "paraview", "pip", "setuptools")
    assert listed - needed == {f"python3-{name}" for name in others}
    assert needed <= listed


def test_packages_for_tests_come_when_a_command_asks_for_them(tmp_path: Path) -> None:
    """docker/run with a tree that says which lists it was asked for."""
    folder = shutil.copytree(DOCKER, tmp_path / "docker", symlinks=True)
    (folder / "prepare-tree.sh").write_text('prepare_tree() { echo "${*:2}"; exit; }\n')
    environment = {**os.environ, "BRISTLE_ENVIRONMENT": "tree"}
    for command, lists in (
        (["bristle", "drop", "--out", "results/tests"], LISTS[:1]),
        (["python3", "-c", "import bristle"], LISTS[:1]),
        (["pytest", "-n", "0"], LISTS),
        (["mpirun", "-n", "2", "python3", "-m", "pytest"], LISTS),
        (["python3", "tests/derived.py"], LISTS),
        (["sh", "-c", "cd docs\nsphinx-build . out"], LISTS),
        (["/usr/bin/mypy"], LISTS),
    ):
        done = subprocess.run(
            [folder / "run", *command],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stdout.split() == list(lists), (command, done.stderr)


def test_the_tree_for_tests_serves_the_program_too(tmp_path: Path) -> None:
    script = """
    source "$docker/common.sh"; source "$docker/prepare-tree.sh"
    name_tree packages; program=$tree
    name_tree packages packages-develop; both=$tree
    mkdir "$program"; prepare_tree "$cache" packages; echo "$tree"
    mkdir "$both"; prepare_tree "$cache" packages; echo "$tree"
    rmdir "$program"; prepare_tree "$cache" packages packages-develop; echo "$tree"
    echo "$program" "$both"
    """
    named = {**os.environ, "docker": str(DOCKER), "cache": str(tmp_path)}
    done = subprocess.run(["bash", "-c", script], env=named, capture_output=True, text=True)
    *found, program, both = done.stdout.split()
    assert found == [program, both, both], done.stderr
    assert program != both


def test_variables_of_the_image_are_set_unless_the_caller_did() -> None:
    ours = dockerfile_variables()
    assert ours["OMP_NUM_THREADS"] == "1"
    without = {name: value for name, value in os.environ.items() if name not in ours}
    seen = dict(
        line.split("=", 1) for line in run("env", env=without).stdout.splitlines() if "=" in line
    )
    assert {name: seen.get(name) for name in ours} == ours

    asked = run("sh", "-c", "echo $OMP_NUM_THREADS", env={**without, "OMP_NUM_THREADS": "3"})
    assert asked.stdout == "3\n"


@pytest.mark.parametrize("status", [0, 3, 130])
def test_exit_status(status: int) -> None:
    assert run("sh", "-c", f"exit {status}").returncode == status


def test_command_that_is_not_there() -> None:
    assert run("no-such-command").returncode == 127


def test_no_command_is_wrong_input() -> None:
    result = run()
    assert result.returncode == 2
    assert "usage: docker/run" in result.stderr


def test_standard_input_and_arguments(tmp_path: Path) -> None:
    assert run("cat", input="a\nb\n").stdout == "a\nb\n"
    echoed = run("printf", "[%s]", "two words", "", "*", cwd=tmp_path)
    assert echoed.stdout == "[two words][][*]"
    assert run("pwd", "-P", cwd=tmp_path).stdout == f"{tmp_path.resolve()}\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_reach_the_command_once(number: signal.Signals) -> None:
    code = (
        "import signal, time\n"
        "seen = []\n"
        f"signal.signal({int(number)}, lambda *_: seen.append(1))\n"
        "print('ready', flush=True)\n"
        "while not seen: time.sleep(0.05)\n"
        "time.sleep(0.5)\n"
        "raise SystemExit(40 + len(seen))\n"
    )
    with subprocess.Popen([RUN, "python3", "-c", code], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(number)
        assert process.wait(timeout=20) == 41


def test_the_package_is_the_live_repository(tmp_path: Path) -> None:
    code = (
        "import bristle, bristle.meshes, bristle.solver;"
        "print(*(each.__file__ for each in (bristle, bristle.meshes, bristle.solver)))"
    )
    files = run("python3", "-c", code, cwd=tmp_path).stdout.split()
    folders = [ROOT / name for name in ("docker/live/bristle", "meshes", "solver")]
    assert [Path(file).resolve().parent for file in files] == folders
    command = run("sh", "-c", "command -v bristle", cwd=tmp_path).stdout.strip()
    assert Path(command).resolve() == DOCKER / "live/bin/bristle"


def test_two_ranks_without_a_warning() -> None:
    code = (
        "from mpi4py import MPI; c = MPI.COMM_WORLD; n = c.allreduce(c.rank + 1);"
        "c.rank == 0 and print(c.size, n)"
    )
    for ranks in (2, 4):
        result = run("mpirun", "-n", str(ranks), "python3", "-c", code)
        assert result.returncode == 0
        assert result.stdout.split() == [str(ranks), str(ranks * (ranks + 1) // 2)]
        assert result.stderr == ""


def test_a_failing_rank_ends_the_job() -> None:
    code = (
        "import os; from mpi4py import MPI; c = MPI.COMM_WORLD\n"
        "if c.rank == 1: os._exit(7)\n"
        "c.barrier()\n"
    )
    assert run("mpirun", "-n", "2", "python3", "-c", code).returncode == 7


SCRIPTS = [
    path
    for folder in (DOCKER, ROOT / ".ci")
    for path in sorted(folder.iterdir())
    if path.is_file() and (path.suffix == ".sh" or path.read_bytes().startswith(b"#!/bin/bash"))
]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_shell_scripts_parse(script: Path) -> None:
    assert len(SCRIPTS) >= 6
    result = subprocess.run(["bash", "-n", script], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert script.suffix == ".sh" or os.access(script, os.X_OK)
