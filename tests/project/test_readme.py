"""Every command of the README and of every --help works, and every number there is true.

What takes minutes is in `test_readme_long`; here it is parsed.
"""

from __future__ import annotations

import importlib.util
import math
import pydoc
import re
import tomllib

import click
import pytest
import readme
from benchmarks.sizes import unknowns
from benchmarks.step import BODIES
from commands import python
from derived import TABLES
from large_rotation import Campaign, speed_kept
from mpi4py import MPI

from bristle.solver import paper
from bristle.solver.effects.library import EFFECTS
from bristle.studies.cli import main
from bristle.studies.data.datasets import read_manifest
from bristle.studies.inputs.choices import Deflection, Model
from bristle.studies.running.cases import CaseSession

pytestmark = pytest.mark.serial

SQUARE_BAR = "studies/measured/square-bar"
STUDIES = readme.REPOSITORY / "studies"
# Scripts that take the flags of a command.
SCRIPTS = {"sweep", "its", "drop", "scatter", "brush", "close-loop", "reproduce"}
OF_OTHERS = {
    "--help",
    "--script",
    "--datasets",
    "--jobs",
    "--rows",
    "--elastica",
}  # click's own, paraview's, a script's of tests
QUICK = (
    ("drop", "--model", "reduced", "--kn"),
    ("drop", "--slope"),
    ("drop", "--effect"),
    ("calibrate", "paper"),
)
COMMANDS = list(dict.fromkeys(readme.commands()))
DROPS = [session for session in readme.sessions() if session.words[1] == "drop"]


def examples() -> list[tuple[str, ...]]:
    """What docstrings offer: every example of --help, every script."""
    lines = []
    for command in readme.GROUP.commands.values():
        found = re.findall(r"Example: (.+)", command.help or "")
        assert found, command.name
        lines += found
    for path in STUDIES.rglob("*.py"):
        head = path.read_text(encoding="utf-8").split('"""')[1]
        lines += re.findall(r"``((?:mpirun -n \d+ )?python3 -m bristle[^`…]+)``", head)
    return [readme.words_of(line) for line in lines]


@pytest.mark.parametrize("words", [*COMMANDS, *examples()], ids=" ".join)
def test_every_command_is_understood(words):
    _, words = readme.without_ranks(words)
    match words[0]:
        case "bristle":
            readme.parse(words[1:])
        case "python3" if words[1] == "-m":
            _understood_by_script(words[2], words[3:])
        case "python3":
            flags = {word for word in words if word.startswith("--")}
            help_text = python(str(readme.REPOSITORY / words[1]), "--help").stdout
            assert flags
            assert flags <= set(re.findall(r"--[\w-]+", help_text))
        case "apptainer":
            assert (readme.REPOSITORY / words[-1]).is_file()
        case "sbatch":
            assert (readme.REPOSITORY / words[1]).is_file()
            readme.parse(("sweep", *words[2:]))
        case _:  # test_install.py installs it
            assert words in (("pytest",), ("pip", "install", "."))


def _understood_by_script(module: str, words: tuple[str, ...]) -> None:
    assert importlib.util.find_spec(module) is not None
    name = module.rpartition(".")[2].replace("_", "-")
    if name in SCRIPTS:
        readme.parse((name, *words))
        return
    flags = {word for word in words if word.startswith("--")}
    if flags:
        assert flags <= set(re.findall(r"--[\w-]+", python("-m", module, "--help").stdout))


def test_a_command_that_is_wrong_is_found_so():
    with pytest.raises(click.UsageError):
        readme.parse(("drop", "--hight", "1"))
    with pytest.raises(click.UsageError):
        readme.parse(("drop", "--model", "brick"))


def test_every_option_that_is_named_is_one():
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", readme.TEXT))
    assert named - readme.options() <= OF_OTHERS


def test_every_module_and_file_that_is_named_is_there():
    for name in re.findall(r"bristle\.studies(?:\.\w+)+", readme.TEXT):
        assert pydoc.locate(name) is not None, name
    for name in re.findall(r"`((?:docker|tests|studies|solver|meshes)/[\w./-]+)`", readme.TEXT):
        assert (readme.REPOSITORY / name).exists(), name
    for name in re.findall(r"!\[[^]]+\]\(([^)]+)\)", readme.TEXT):
        assert 0 < (readme.REPOSITORY / name).stat().st_size < 150_000


@pytest.mark.parametrize("session", DROPS, ids=lambda session: " ".join(session.words))
def test_drops_give_the_numbers_that_are_shown(session, tmp_path):
    # the reduced solid stands for the solid, from which it differs by less than is shown
    words = ["reduced" if word == "solid" else word for word in session.words[1:]]
    assert readme.run(session, tmp_path, words) == []


def test_a_number_that_is_not_true_is_found_so():
    lines = ("rebound ratio y1/y0     0.6575", "contact time            0.164 ms")
    shown = readme.Session((), lines)
    near = "rebound ratio y1/y0     0.6574\ncontact time            0.1635 ms\n"
    assert readme.compare(shown, near) == []
    off = "rebound ratio y1/y0     0.6577\ncontact time            0.164 s\n"
    assert len(readme.compare(shown, off)) == 2
    assert readme.compare(shown, off[:30]) != []


@pytest.mark.parametrize(
    "words",
    [words[1:] for words in COMMANDS if any(words[1 : 1 + len(q)] == q for q in QUICK)],
    ids=" ".join,
)
def test_what_is_quick_runs_and_ends_with_what_to_look_at(words, tmp_path, monkeypatch, capsys):
    if "solid" in words:
        pytest.skip("the solid is in test_readme_long")
    monkeypatch.chdir(tmp_path)
    assert main(list(words)) == 0
    last = [line.split()[-1] for line in capsys.readouterr().out.splitlines()[-2:]]
    assert any((tmp_path / name).is_file() for name in last)


def test_less_friction_leaves_less(tmp_path, monkeypatch, capsys):
    shown = readme.number("leaning-without-friction")
    (leaning,) = [session for session in DROPS if "--tilt" in session.words]
    monkeypatch.chdir(tmp_path)
    assert main([*leaning.words[1:], "--friction", "0"]) == 0
    (ratio,) = re.findall(r"rebound ratio y1/y0 +([\d.]+)", capsys.readouterr().out)
    assert readme.agree(shown, float(ratio))


def test_the_beam_leans_as_the_table_says():
    how = (Model.BEAM, Deflection.SECOND_ORDER, 0.05, 0.0)
    for lean, _, beam, *_ in readme.table("leaning"):
        with CaseSession(MPI.COMM_SELF) as session:
            kept, _ = speed_kept(session, Campaign().case(*how, float(lean.rstrip("°"))))
        assert readme.agree(beam, kept), lean


@pytest.mark.parametrize("table", ["leaning-options", "mesh-options", "loop-options"])
def test_defaults_of_the_options_are_as_the_tables_say(table):
    for names, default, _ in readme.table(table):
        for name, shown in zip(
            re.findall(r"`(--[\w-]+)`", names), default.split(", "), strict=False
        ):
            (option,) = {
                parameter
                for command in ("drop", "close-loop")
                for parameter in readme.GROUP.commands[command].params
                if name in parameter.opts
            }
            help_text = getattr(option, "help", "") or ""
            if re.fullmatch(r"[\d.]+|`\w+`", shown):
                found = re.search(r"\[default: ([^\]]+)\]", help_text)
                assert found is not None, name
                assert found[1] == shown.strip("`"), name


def test_every_mark_is_read_by_a_test():
    marks = readme.marks()
    assert len(set(marks)) == len(marks)
    tests = sorted((readme.REPOSITORY / "tests").rglob("test_*.py"))
    text = "\n".join(path.read_text(encoding="utf-8") for path in tests)
    derived = {f"options: {name}" for name in TABLES}  # which a test of theirs reads
    assert [name for name in marks if f'"{name}"' not in text and name not in derived] == []


def test_a_mark_is_found_wherever_its_number_stands(monkeypatch):
    text = "From 1.5e-3<!-- first --> to\n-2<!-- second -->.\n"
    text += "<!-- table: third -->\n| a |\n|---|\n| 7 |\n"
    monkeypatch.setattr(readme, "TEXT", text)
    assert readme.number("first") == "1.5e-3"
    assert readme.number("second") == "-2"
    assert readme.table("third") == [["7"]]
    assert readme.marks() == ["first", "second", "third"]
    monkeypatch.setattr(readme, "TEXT", text.replace("2<", "2 <"))
    with pytest.raises(ValueError, match="unpack"):
        readme.number("second")


def test_the_effects_are_those_of_the_library():
    told: dict[str, str] = {}
    for names, parameters, _ in readme.table("effects"):
        found = re.findall(r"`(\w+)`", names)
        given = [re.findall(r"`(\w+)`", part) for part in parameters.split("; ")[0].split(", ")]
        for name, (parameter, *_) in zip(found, given, strict=True):
            told[name] = parameter
    assert told == {name: each.parameters[0].name for name, each in EFFECTS.items()}


def test_what_was_measured_is_what_the_paper_says():
    told = {
        "measured-mean": paper.RATIO_MEAN,
        "measured-std": paper.RATIO_STD,
        "measured-drops": paper.N_DROPS,
        "thickness-mm": pytest.approx(1e3 * paper.THICKNESS_M),
        "width-mm": pytest.approx(1e3 * paper.WIDTH_M),
        "length-mm": pytest.approx(1e3 * paper.LENGTH_M),
        "paper-beta": paper.BETA_S,
    }
    assert {name: float(readme.number(name)) for name in told} == told
    (bar,) = [session for session in readme.sessions() if SQUARE_BAR in session.words]
    (found,) = [line.split()[1] for line in bar.lines if line.startswith("beta_s")]
    times = float(readme.number("beta-too-large"))
    assert times == pytest.approx(paper.BETA_S / float(found), rel=0.05)


def test_bodies_that_steps_are_measured_on_have_the_unknowns_told():
    told = [int(row[0].replace(" ", "")) for row in readme.table("steps")]
    assert told == [unknowns(cells) for cells, order in BODIES if order == 2]


def test_datasets_are_declared_as_they_are_read(tmp_path):
    film, heights, declared_bar = readme.blocks("toml")
    for kind, declared in (("tracks", film), ("drops", heights)):
        folder = tmp_path / kind
        folder.mkdir()
        (folder / "dataset.toml").write_text(declared)
        assert read_manifest(folder).kind == kind
    bar = tomllib.loads(declared_bar)
    assert [table.splitlines()[0] for table in readme.blocks("csv")] == [
        "drop,t_s,y_mm",
        "drop,y0_mm,y1_mm",
    ]
    path = readme.REPOSITORY / SQUARE_BAR / "dataset.toml"
    for part, keys in tomllib.loads(path.read_text()).items():
        if part in ("body", "measurement"):
            assert bar[part] == keys
    assert math.isclose(bar["body"]["length_m"], 2 * bar["measurement"]["gauge_x_m"])


def test_the_measured_bar_gives_what_is_shown(tmp_path):
    (session,) = [each for each in readme.sessions() if SQUARE_BAR in each.words]
    (tmp_path / "studies").symlink_to(readme.REPOSITORY / "studies")
    assert readme.run(session, tmp_path) == []
    assert (tmp_path / "results" / "close-loop" / "report.html").is_file()
