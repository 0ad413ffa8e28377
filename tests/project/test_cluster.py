"""The batch script and the recipe of the cluster's image, read and not run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from bristle.studies.inputs.fields import LIST_FLAGS
from bristle.studies.running.parallel import launched_ranks, speaks

DOCKER = Path(__file__).resolve().parents[2] / "docker"
SCRIPT, DEFINITION = DOCKER / "cluster.sbatch", DOCKER / "bristle.def"
# sbatch(1), those that take a value
SBATCH = {
    "account", "array", "chdir", "constraint", "cpus-per-task", "dependency", "error",
    "gres", "hint", "job-name", "mail-type", "mail-user", "mem", "mem-per-cpu", "nodes", "ntasks",
    "ntasks-per-core", "ntasks-per-node", "output", "partition", "qos", "reservation", "signal",
    "time",
}  # fmt: skip
# Apptainer's definition files
SECTIONS = {"files", "post", "environment", "runscript", "startscript", "test", "labels", "help"}

pytestmark = pytest.mark.serial


def joined(text: str) -> list[str]:
    """Lines of a shell script, continued ones as one, comments left out."""
    lines = text.replace("\\\n", " ").splitlines()
    return [line for raw in lines if (line := " ".join(raw.split())) and not line.startswith("#")]


def sections() -> dict[str, str]:
    parts = re.split(r"^%(\w+)\n", DEFINITION.read_text(), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def header() -> dict[str, str]:
    top = DEFINITION.read_text().split("\n%", 1)[0]
    return dict(line.split(": ", 1) for line in joined(top))


def dockerfile(instruction: str) -> list[str]:
    """Its arguments in the stages that users run: the environment, and the project on top of it."""
    text = re.sub(
        r"(?ms)^FROM environment AS .*?(?=^FROM)", "", (DOCKER / "Dockerfile").read_text()
    )
    return [
        line.removeprefix(f"{instruction} ")
        for line in joined(text)
        if line.startswith(f"{instruction} ")
    ]


def test_slurm_reads_every_option():
    text = SCRIPT.read_text()
    lines = [line for line in text.splitlines() if line.startswith("#SBATCH")]
    options = [re.fullmatch(r"#SBATCH --([a-z-]+)=(\S+)", line) for line in lines]
    assert all(options), lines
    found = {each[1]: each[2] for each in options if each}
    assert len(found) == len(lines)
    assert found.keys() <= SBATCH
    assert found.keys() >= {"nodes", "ntasks-per-node", "time"}
    assert re.fullmatch(r"(\d+-)?\d\d:\d\d:\d\d", found["time"])
    # sbatch reads no option below the first command
    first = next(i for i, line in enumerate(text.splitlines()) if line.startswith("set "))
    assert all(text.splitlines().index(line) < first for line in lines)


def test_slurm_runs_a_command_that_there_is():
    (launch,) = [line for line in joined(SCRIPT.read_text()) if line.startswith("srun")]
    words = shlex.split(launch)
    assert words[:4] == ["srun", "--mpi=pmix", "apptainer", "run"]
    arguments = words[words.index("$image") + 1 :]
    assert arguments[0] == "sweep"
    options = {flag.option for flag in LIST_FLAGS} | {"--out"}
    assert {word for word in arguments if word.startswith("--")} <= options


def test_the_definition_has_the_sections_that_apptainer_knows():
    assert header() == {"Bootstrap": "docker", "From": dockerfile("FROM")[0].split()[0]}
    assert sections().keys() <= SECTIONS
    assert sections().keys() >= {"files", "post", "environment", "runscript"}
    assert "%files" in DEFINITION.read_text()


def test_both_images_are_made_by_the_same_commands():
    # a container of Apptainer's runs as whoever starts it
    runs = [run for run in dockerfile("RUN") if not run.startswith("useradd")]
    steps = [step.strip() for run in runs for step in run.split("&&")]
    assert joined(sections()["post"]) == ["set -e", *steps]


def test_both_images_set_the_same_variables():
    ours = dict(line.split("=", 1) for line in dockerfile("ENV"))
    assert ours.pop("HOME") == "/home/bristle"
    theirs = {}
    for line in joined(sections()["environment"]):
        name, default = re.fullmatch(r'export (\w+)="\$\{\1:-(.*)\}"', line).groups()
        theirs[name] = default
    assert theirs == ours


def test_what_the_definition_copies_is_there_and_is_all():
    copied = dict(line.split() for line in joined(sections()["files"]))
    root = DOCKER.parent
    assert copied.pop("docker/packages") == "/tmp/packages"
    assert all((root / source).exists() for source in copied)
    assert all(target == f"/usr/local/src/bristle/{source}" for source, target in copied.items())
    live = (DOCKER / "live" / "bristle").iterdir()
    packages = {path.name for path in live if path.is_symlink()}
    assert copied.keys() >= {*packages, "docker", "pyproject.toml", "README.md", "LICENSE"}


@pytest.mark.parametrize(("pmix", "ranks", "first"), [(True, 32, False), (False, 1, True)])
def test_ranks_that_slurm_launches_know_themselves(pmix, ranks, first, monkeypatch):
    for name in ("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK", "PMI_SIZE", "PMI_RANK"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("SLURM_STEP_NUM_TASKS", "32")
    monkeypatch.setenv("SLURM_PROCID", "3")
    monkeypatch.delenv("PMIX_RANK", raising=False)
    if pmix:
        monkeypatch.setenv("PMIX_RANK", "3")
    assert (launched_ranks(), speaks()) == (ranks, first)
