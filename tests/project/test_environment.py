"""The environment is what docker/packages says, and docker/run passes everything on."""

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


def package_list() -> list[str]:
    lines = (DOCKER / "packages").read_text().splitlines()
    return [name for line in lines if (name := line.partition("#")[0].strip())]


def dockerfile_variables() -> dict[str, str]:
    lines = (DOCKER / "Dockerfile").read_text().splitlines()
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
        ("slepc4py", (3, 22)),
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
    listed = package_list()
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


def test_image_and_tree_are_made_from_the_one_list() -> None:
    assert len(package_list()) == len(set(package_list())) > 20
    dockerfile = (DOCKER / "Dockerfile").read_text()
    recipe = (DOCKER / "prepare-tree.sh").read_text()
    assert "COPY docker/packages" in dockerfile
    assert '"$docker/packages"' in recipe
    for name in package_list():
        own_name = rf"(?<![\w/-]){re.escape(name)}(?![\w-])"
        lists = [line for line in dockerfile.splitlines() if "apt-get install" in line]
        assert not re.search(own_name, "\n".join(lists).replace("xargs", "")), name


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
