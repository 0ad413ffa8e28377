"""Nothing of the user's is touched, whatever it is called and wherever ``--out`` points.

Each command runs once, and tells by its mark what it writes. Then something of the user's has each
of these names, one after the other.
"""

import itertools
import json
import os
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest
from faults import FULL_SOLID, ended, hidden, journal_lines, send, started, told, wait_for
from hostile import kept_promise, refused, run, write_dataset
from small_reproduction import small, toy

from bristle.solver.errors import InputError
from bristle.studies.close_loop import run as loop_study
from bristle.studies.data.datasets import read_drops
from bristle.studies.drop import run_drop
from bristle.studies.inputs.config import DropInputs
from bristle.studies.reproduce import run as reproduce_study
from bristle.studies.running import files
from bristle.studies.running.mark import MARK, Mark

pytestmark = [pytest.mark.serial, pytest.mark.usefixtures("no_pictures")]

CELLS = ("--cells", "1", "1", "8")
SOLID = ("drop", "--model", "solid", *CELLS, "--order", "1", "--its", "2e-5")
SWEEP = ("sweep", "--models", "analytic", "--kn", "1e5,2e6", "--its", "1e-5,1e-6")
SHORT = ("--elements", "3", "--until", "0.004", "--every", "0.001")
# Commands, and what of each computes.
COMMANDS = {
    "drop": (SOLID, "bristle.studies.drop.session_on"),
    "sweep": ((*SWEEP, "--friction", "0,0.5"), "running.study.session_on"),
    "its": (
        ("its", "--models", "analytic", "--kn", "1e5", "--its", "1e-4,1e-5,1e-6"),
        "running.study.session_on",
    ),
    "scatter": (("scatter", "--drops", "10", "--model", "beam", "--flat"), "scatter.run.Scene"),
    "brush": (("brush", *SHORT), "brush.run.make_rods"),
    "calibrate": (("calibrate", "paper"), "calibrate.run.calibrate"),
    "close-loop": (("close-loop", "DATA", "--no-3d"), "close_loop.run.problem_of"),
    "synth": (("synth", "--drops", "6"), "synth.reduced_body"),
    "mesh": (("mesh", *CELLS), "mesh.run._make"),
    "view": (("view", "RESULT"), "view.run.write_picture"),
    "reproduce": (("reproduce",), "reproduce.run.CaseSession"),
}


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """A dataset and a solid's result."""
    folder = tmp_path_factory.mktemp("given")
    write_dataset(folder / "DATA", "drops")
    assert run(*SOLID, "--out", folder / "RESULT")[0] == 0
    return folder


@pytest.fixture
def call(given, monkeypatch):
    """A function that runs a command of `COMMANDS` into a folder, the long ones in a small way."""
    drops = read_drops(given / "DATA")
    monkeypatch.setattr(loop_study, "problem_of", lambda manifest: toy(drops))
    monkeypatch.setattr(reproduce_study, "paper_studies", lambda setup: small()[1][2:3])

    def call(name, out):
        words = [given / word if word in ("DATA", "RESULT") else word for word in COMMANDS[name][0]]
        truth = ["--truth", out.with_name("truth.json")] if name == "synth" else []
        return run(*words, *truth, "--out", out)

    return call


@contextmanager
def named(monkeypatch, out):
    """The names that the mark of ``out`` is given inside the block."""
    names, write = set(), Mark.write

    def noted(mark):
        if mark.folder.resolve() == out:
            names.update(mark.files, mark.growing)
        write(mark)

    with monkeypatch.context() as patched:
        patched.setattr(Mark, "write", noted)
        yield names


def tree(folder):
    """All that lies below a folder, links as such."""
    return {
        str(path.relative_to(folder)): str(path.readlink())
        if path.is_symlink()
        else path.is_dir() or path.read_bytes()
        for path in folder.rglob("*")
    }


def a_file(path, elsewhere):
    path.write_text("the user's")


def a_folder(path, elsewhere):
    path.mkdir()
    (path / "solid.bp").write_text("the user's")


def a_link_to_a_file(path, elsewhere):
    (elsewhere / "file").write_text("the user's")
    path.symlink_to(elsewhere / "file")


def a_link_to_a_folder(path, elsewhere):
    a_folder(elsewhere / "folder", elsewhere)
    path.symlink_to(elsewhere / "folder")


def a_dead_link(path, elsewhere):
    path.symlink_to(elsewhere / "nothing")


@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_the_users_is_refused_before_anything_is_computed(
    tmp_path, monkeypatch, call, name
):
    out = tmp_path / "own"
    with named(monkeypatch, out) as names:
        monkeypatch.chdir(tmp_path)
        for each in (out, Path("own")):  # and its own results it replaces
            status, _, lines = call(name, each)
            assert status == 0, lines
            assert MARK not in Mark.read(out).files
    there = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    assert there - {MARK} <= names
    assert hidden(out) == []

    def computes(*args, **kwargs):
        raise AssertionError(f"{name} computes")

    work = COMMANDS[name][1]
    monkeypatch.setattr(f"bristle.studies.{work.removeprefix('bristle.studies.')}", computes)
    users = [a_file, a_folder, a_link_to_a_file, a_link_to_a_folder, a_dead_link]
    tops = {each.split("/")[0] for each in names}
    # one name is each of these, the others one each in turn
    first, *others = sorted(tops)
    tried = [(first, make) for make in users] + list(zip(others, itertools.cycle(users)))
    for i, (top, make) in enumerate(tried):
        folder = tmp_path / str(i)
        (folder / "out").mkdir(parents=True)
        (folder / "elsewhere").mkdir()
        make(folder / "out" / top, folder / "elsewhere")
        (folder / "out" / "notes.txt").write_text("the user's too")
        before = tree(folder)
        status, _, lines = call(name, folder / "out")
        said = kept_promise(status, lines)
        assert status == 2, (top, make)
        assert str(folder / "out" / top) in said
        assert "move it away, or choose another --out" in said
        assert tree(folder) == before


def test_the_script_beside_a_result_may_be_the_users(given, tmp_path, call):
    script = given / "RESULT" / "open_in_paraview.py"
    script.unlink(missing_ok=True)
    script.write_text("# the user's")
    status, _, lines = call("view", tmp_path / "view")
    assert status == 2
    assert str(script) in kept_promise(status, lines)
    assert script.read_text() == "# the user's"
    assert not (tmp_path / "view").exists()
    script.unlink()


def test_a_truth_that_is_none_stays(tmp_path):
    for content in ("the user's", "[]", '{"schema": "mine"}'):
        (tmp_path / "truth.json").write_text(content)
        out, truth = tmp_path / "out", tmp_path / "truth.json"
        said = refused("synth", "--drops", "6", "--out", out, "--truth", truth)
        assert f"--truth {truth}: was not written by this" in said
        assert not out.exists()
        assert truth.read_text() == content


DROP = ("drop", "--model", "analytic")


@pytest.fixture
def result(tmp_path):
    """A drop's folder with notes of the user's among its files."""
    assert run(*DROP, "--out", tmp_path)[0] == 0
    (tmp_path / "notes.txt").write_text("the user's")
    return tmp_path


def test_a_result_that_the_user_edited_is_his(result):
    table = result / "history.csv"
    table.write_text(table.read_text() + "# the user's\n")
    before = tree(result)
    assert f"{table}: has changed since this program wrote it" in refused(*DROP, "--out", result)
    assert tree(result) == before
    assert run(*DROP, "--out", result, "--resume")[0] == 0  # which has nothing to do
    assert tree(result) == before


def test_but_notes_beside_it_are_in_nobodys_way(result):
    status, _, _ = run(*DROP, "--kn", "1e6", "--out", result)
    assert status == 0
    assert (result / "notes.txt").read_text() == "the user's"
    assert json.loads((result / "result.json").read_text())["inputs"]["kn_N_m"] == 1e6


def test_a_moved_result_is_still_the_programs(result, tmp_path_factory):
    other = tmp_path_factory.mktemp("moved") / "copy"
    other.mkdir()
    for path in result.iterdir():
        (other / path.name).write_bytes(path.read_bytes())
    assert run(*DROP, "--kn", "1e6", "--out", other)[0] == 0


@pytest.mark.parametrize(
    "content",
    [
        "the user's",
        "[]",
        '{"schema": "bristle-written-1"}',
        '{"schema": "bristle-written-1", "files": {"result.json": 1}, "growing": []}',
    ],
)
def test_a_mark_that_is_none_is_no_mark(result, content):
    (result / MARK).write_text(content)
    before = tree(result)
    assert str(result / MARK) in refused(*DROP, "--out", result)
    assert tree(result) == before


def test_a_mark_reaches_nothing_outside_its_folder(result, tmp_path_factory):
    other = tmp_path_factory.mktemp("other") / "fields"
    other.write_text("the user's")
    mark = Mark.read(result)
    mark.files[f"fields/../{os.path.relpath(other, result)}"] = [files.digest(other)]
    mark.write()
    assert run(*DROP, "--out", result)[0] == 0
    assert other.read_text() == "the user's"


def test_studies_in_one_folder_leave_each_other_alone(result):
    before = tree(result)
    assert run(*SWEEP, "--out", result)[0] == 0
    assert run("calibrate", "paper", "--out", result)[0] == 0
    before.pop(MARK)
    assert before.items() <= tree(result).items()
    for again in (DROP, SWEEP, ("calibrate", "paper")):
        assert run(*again, "--out", result)[0] == 0


def test_pictures_of_an_earlier_sweep_go_unless_the_user_edited_them(tmp_path):
    assert run(*SWEEP, "--out", tmp_path)[0] == 0
    assert len(list(tmp_path.glob("heights-its-*"))) == 4
    edited = tmp_path / "heights-its-1e-05.svg"
    edited.write_text("the user's")
    assert run(*SWEEP[:-1], "1e-7", "--out", tmp_path)[0] == 0
    left = {path.name for path in tmp_path.glob("heights*")}
    assert left == {edited.name, "heights.png", "heights.svg"}


def test_pictures_of_a_solid_go_when_another_drop_takes_its_place(tmp_path):
    out, view = tmp_path / "out", tmp_path / "out" / "view"
    assert run(*SOLID, "--out", out)[0] == 0
    assert run("view", out)[0] == 0
    assert (view / "wave.gif").exists()
    (view / "mine.png").write_text("the user's")
    assert run(*DROP, "--out", out)[0] == 0
    assert not (out / "open_in_paraview.py").exists()
    assert run("view", out)[0] == 0
    left = {path.name for path in view.iterdir()}
    assert left == {"history.svg", "history.png", "mine.png", MARK}


def test_what_the_user_adds_to_fields_stays_and_theirs_goes(tmp_path):
    assert run(*SOLID, "--out", tmp_path)[0] == 0
    (tmp_path / "fields" / "mine.pvsm").write_text("the user's")
    assert run(*SOLID, "--out", tmp_path)[0] == 0
    assert (tmp_path / "fields" / "frames.csv").exists()
    assert run(*DROP, "--out", tmp_path)[0] == 0
    assert [path.name for path in (tmp_path / "fields").rglob("*")] == ["mine.pvsm"]


def test_python_is_refused_as_the_command_is(tmp_path):
    (tmp_path / "fields").mkdir()
    (tmp_path / "fields" / "mine").write_text("the user's")
    with pytest.raises(InputError, match="fields: was not written by this program"):
        run_drop(DropInputs(model="analytic"), tmp_path)


# --- killed ---------------------------------------------------------------------------------------

MOMENTS = ["mark", "aside", "first", "last"]


class Killed(BaseException):
    """As by SIGKILL: nothing is cleaned up."""


@pytest.mark.parametrize("moment", MOMENTS)
def test_killed_while_files_take_their_places_the_folder_can_be_used_again(
    result, monkeypatch, moment
):
    replace, done = Path.replace, []

    def killed(path, target):
        if path.name == MARK and moment != "mark":
            return replace(path, target)
        done.append(path.name)
        count = {"mark": 1, "aside": 1, "first": 2, "last": 3}[moment]
        if len(done) >= count:
            raise Killed
        return replace(path, target)

    def write():
        with files.together(result, "result.json"):
            files.remove(result / "history.csv")
            files.write_atomically(result / "report.html", "new")
            files.write_atomically(result / "result.json", "new")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", killed)
        patched.setattr(files.shutil, "rmtree", lambda *args, **kwargs: None)
        with pytest.raises(Killed):
            write()
    for kwargs in ({}, {"kn_N_m": 1e6}):
        run_drop(DropInputs(model="analytic", **kwargs), result)
    assert hidden(result) == []
    assert (result / "notes.txt").read_text() == "the user's"
    files.prepare_folder(result, "report.html")  # which may be there or not, and is the program's


def test_what_the_user_puts_where_a_killed_run_meant_to_write_is_his(tmp_path):
    """The mark names it already, and it is not there yet."""
    mark = Mark(tmp_path)
    mark.add({"result.json": "0" * 32})
    mark.write()
    (tmp_path / "result.json").write_text("the user's")
    assert str(tmp_path / "result.json") in refused(*DROP, "--out", tmp_path)
    assert (tmp_path / "result.json").read_text() == "the user's"


def test_what_looks_unfinished_and_has_no_mark_stays(tmp_path):
    theirs = tmp_path / f"{files.UNFINISHED}mine"
    theirs.mkdir()
    (theirs / "notes.txt").write_text("the user's")
    (tmp_path / f"{files.UNFINISHED}link").symlink_to(theirs)
    (tmp_path / f"{files.UNFINISHED}empty").mkdir()
    (tmp_path / ".my-settings").write_text("the user's")
    assert run(*DROP, "--out", tmp_path)[0] == 0
    assert (tmp_path / ".my-settings").exists()
    assert (theirs / "notes.txt").read_text() == "the user's"
    assert (tmp_path / f"{files.UNFINISHED}link").is_symlink()
    assert not (tmp_path / f"{files.UNFINISHED}empty").exists()


@pytest.fixture(scope="module")
def whole_solid(tmp_path_factory):
    """What a solid's drop that nobody kills leaves, and its command."""
    long = [*FULL_SOLID, "--its", "1e-6"]
    out = tmp_path_factory.mktemp("solid")
    assert run(*long, "--out", out)[0] == 0
    return long, told(out)


@pytest.mark.parametrize(("resume", "after_marks"), [(False, 1), (True, 1), (True, 4)])
def test_a_solid_that_was_killed_starts_anew_or_goes_on_to_the_bit(
    tmp_path, whole_solid, resume, after_marks
):
    long, whole = whole_solid
    out, marks = tmp_path / "out", set()
    process = started([*long, "--out", out])

    def marked():
        marks.update(path.name for path in (out / "checkpoint").glob("march-*.npz"))
        return len(marks) >= after_marks

    wait_for(marked, process)
    send(process, signal.SIGKILL)
    assert ended(process)[0] == -signal.SIGKILL
    assert not (out / "result.json").exists()
    (out / "checkpoint" / "notes.txt").write_text("the user's")
    status, _, lines = ended(started([*long, "--out", out, *["--resume"] * resume]))
    assert status == 0, lines
    assert hidden(out) == []
    assert [path.name for path in (out / "checkpoint").iterdir()] == ["notes.txt"]
    (out / "checkpoint" / "notes.txt").unlink()
    assert told(out) == whole
    assert ended(started([*DROP, "--out", out]))[0] == 0
    assert sorted(path.name for path in out.iterdir()) == ["history.csv", "result.json", MARK]


def test_a_study_that_was_killed_over_an_earlier_one_starts_anew(tmp_path):
    sweep = ["sweep", "--models", "beam", "--its", "1e-6", "--heights", "0.01", "--out", tmp_path]
    assert run(*sweep)[0] == 0
    whole = told(tmp_path)
    process = started(sweep)
    wait_for(lambda: 2 <= journal_lines(tmp_path) < 9, process)
    send(process, signal.SIGKILL)
    ended(process)
    assert run(*sweep)[0] == 0
    assert told(tmp_path) == whole


def test_all_ranks_end_where_one_folder_is_the_users(tmp_path):
    (tmp_path / "report.html").write_text("the user's")
    process = started(["scatter", "--drops", "10", "--out", tmp_path], ranks=2)
    status, _, lines = ended(process)
    assert status == 2
    assert any("report.html: was not written by this program" in line for line in lines)
    assert (tmp_path / "report.html").read_text() == "the user's"
