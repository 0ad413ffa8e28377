"""The program keeps its promise whatever configuration, dataset or command line it is given.

Thousands of each in the campaign, some of each always.
"""

import contextlib
import json
import os
import sys
import tempfile
import tomllib
from pathlib import Path

import click
import pytest
from hostile import (
    NASTY_NUMBERS,
    NASTY_TEXT,
    READERS,
    TABLES,
    configurations,
    document,
    drops_table,
    hostile_datasets,
    kept_promise,
    manifest,
    refused,
    run,
    write_dataset,
    write_files,
)
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from web_page import Page

from bristle.solver.errors import InputError
from bristle.studies import bench as bench_study
from bristle.studies import drop as drop_study
from bristle.studies import its as its_study
from bristle.studies import sweep as sweep_study
from bristle.studies import synth as synth_study
from bristle.studies.brush import run as brush_study
from bristle.studies.calibrate import run as calibrate_study
from bristle.studies.cli import app
from bristle.studies.close_loop import run as loop_study
from bristle.studies.data.datasets import read_drops, read_manifest
from bristle.studies.mesh import run as mesh_study
from bristle.studies.report.page import Column, Table
from bristle.studies.reproduce import run as reproduce_study
from bristle.studies.scatter import run as scatter_study

pytestmark = pytest.mark.serial

TITLE = "<script>alert(1)</script>&\"'<img src=x onerror=alert(2)>"


# Some always, thousands in the campaign.
SOME_OR_MANY = pytest.mark.parametrize(
    "count", [150, pytest.param(5000, marks=pytest.mark.campaign)], ids=["some", "thousands"]
)


def tried(count, promises, *examples, **strategies):
    """Try so many cases beside the examples, shrunk and remembered nowhere."""
    test = given(**strategies)(promises)
    for each in examples:
        test = example(*each)(test)
    how = {"deadline": None, "database": None, "suppress_health_check": list(HealthCheck)}
    settings(max_examples=count, **how)(test)()


@pytest.fixture
def marked(monkeypatch):
    """Commands that end where they would begin to compute; what they were about to compute."""
    seen = []

    def stands_for(module, name):
        def marker(*arguments, **options):
            seen.append((name, arguments))
            raise InputError("reached")

        monkeypatch.setattr(module, name, marker)

    stands_for(drop_study, "_compute")
    for module, name in [
        (sweep_study, "run_sweep"),
        (its_study, "run_its"),
        (mesh_study, "run_mesh"),
        (reproduce_study, "run_reproduce"),
        (scatter_study, "Scene"),
        (brush_study, "make_rods"),
        (calibrate_study, "calibrate"),
        (synth_study, "run_synth"),
        (loop_study, "_simulate"),
        (bench_study, "import_module"),
    ]:
        stands_for(module, name)
    return seen


@pytest.fixture
def watched():
    """What Python opens for reading, or starts, while a test says so."""
    return _Watch()


class _Watch:
    """An audit hook cannot be taken out again, so it is told when to listen."""

    def __init__(self):
        self.heard, self.listening = [], False
        sys.addaudithook(self._hear)

    def _hear(self, event, arguments):
        if not self.listening:
            return
        if event == "open" and isinstance(arguments[0], str | bytes):
            self.heard.append(("open", os.path.realpath(os.fsdecode(arguments[0]))))
        elif event in ("exec", "subprocess.Popen", "os.system", "socket.connect"):
            self.heard.append((event, ""))


# --- configurations -------------------------------------------------------------------------------

STUDIES = ("drop", "sweep", "its", "mesh", "reproduce", "scatter", "brush")


@SOME_OR_MANY
def test_any_configuration_is_refused_or_sound(marked, count):
    def promises(content, command):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "config.toml"
            path.write_bytes(content)
            status, _, lines = run(command, "--config", path, "--out", Path(folder) / "out")
            message = kept_promise(status, lines)
            assert status == 2
            if marked:
                assert message == "reached"
                marked.clear()
            else:
                assert str(path) in message or message.startswith("--")
                assert not (Path(folder) / "out").exists()
            assert {each.name for each in Path(folder).iterdir()} <= {"config.toml", "out"}

    tried(
        count,
        promises,
        (b"a = " + b"[" * 100_000, "drop"),
        (b"kn = 0x1" + b"0" * 5000, "drop"),
        (b"kn = 1" + b"0" * 5000, "drop"),
        (b"kn = -1e400", "sweep"),
        (b"\xff\xfe", "drop"),
        (b"effect = [{}]", "drop"),
        (b'"\\u001b[2J" = 1', "drop"),
        content=configurations(),
        command=st.sampled_from(STUDIES),
    )


@pytest.mark.parametrize("start", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("end", [b"\n", b"\r\n"])
def test_editors_of_all_kinds_may_write_one(tmp_path, marked, start, end):
    (tmp_path / "c.toml").write_bytes(start + b"kn = 1e6" + end + b"height = 0.02" + end)
    run("drop", "--config", tmp_path / "c.toml", "--out", tmp_path / "out")
    ((_, (inputs, *_)),) = marked
    assert (inputs.kn_N_m, inputs.height_m) == (1e6, 0.02)


@pytest.mark.parametrize("kind", ["folder", "loop", "absent", "endless", "binary"])
def test_what_is_no_file_is_no_configuration(tmp_path, kind):
    path = tmp_path / "c.toml"
    if kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "endless":
        path = Path("/dev/zero")
    elif kind == "binary":
        path.write_bytes(bytes(range(256)))
    said = refused("drop", "--config", path, "--out", tmp_path / "out")
    assert said.startswith(f"--config {path}: cannot be read")
    assert not (tmp_path / "out").exists()


# --- datasets -------------------------------------------------------------------------------------


@SOME_OR_MANY
@pytest.mark.parametrize("kind", list(TABLES))
def test_any_dataset_is_refused_or_sound(kind, count):
    def promises(files):
        with tempfile.TemporaryDirectory() as name:
            folder = write_files(Path(name) / "data", files)
            read, told = None, ""
            try:
                read = READERS[kind](folder)
            except InputError as error:
                told = str(error)
            assert str(folder) in told or read.manifest.kind == kind

    tried(count // 3, promises, files=hostile_datasets(kind))


@pytest.mark.parametrize("kind", list(TABLES))
def test_sound_ones_are_read_and_nothing_beside_them(tmp_path, kind, watched):
    folder = write_dataset(tmp_path / "data", kind)
    READERS[kind](folder)  # what Python itself imports first
    watched.listening = True
    read = READERS[kind](folder)
    watched.listening = False
    assert read.manifest.title == "T"
    opened = {path for event, path in watched.heard if event == "open"}
    assert opened <= {str(path) for path in folder.resolve().iterdir()}
    assert {event for event, _ in watched.heard} == {"open"}


@pytest.mark.parametrize(
    "name",
    ["../secret.csv", "/etc/passwd", "link.csv", "inner/secret.csv", "a\0b", ".", "", "x" * 5000],
)
def test_no_file_leads_out_of_the_folder(tmp_path, name, watched):
    folder = write_dataset(
        tmp_path / "data", "drops", manifest("drops", measurement={"file": name})
    )
    (tmp_path / "outside").mkdir()
    for secret in (tmp_path / "secret.csv", tmp_path / "outside" / "secret.csv"):
        secret.write_text(drops_table())
    (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
    (folder / "inner").symlink_to(tmp_path / "outside")
    watched.listening = True
    with pytest.raises(InputError, match="outside the dataset's folder|null|no such file"):
        read_drops(folder)
    watched.listening = False
    assert {path for event, path in watched.heard} == {str((folder / "dataset.toml").resolve())}


def test_a_manifest_may_not_lie_elsewhere(tmp_path):
    there = write_dataset(tmp_path / "there", "drops")
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "dataset.toml").symlink_to(there / "dataset.toml")
    with pytest.raises(InputError, match="lies outside the dataset's folder"):
        read_manifest(folder)


@pytest.mark.parametrize("what", ["dataset.toml", "drops.csv"])
@pytest.mark.parametrize("kind", ["folder", "pipe", "loop"])
def test_what_is_no_plain_file_is_not_waited_for(tmp_path, what, kind):
    folder = write_dataset(tmp_path / "data", "drops")
    (folder / what).unlink()
    if kind == "folder":
        (folder / what).mkdir()
    elif kind == "pipe":
        os.mkfifo(folder / what)
    else:
        (folder / what).symlink_to(folder / what)
    with pytest.raises(InputError, match=f"{what}: (is not a plain|no such) file"):
        read_drops(folder)


def test_a_bar_too_short_for_its_record_is_named(tmp_path):
    tree = manifest("waves", body={"length_m": 0.002, "width_m": 0.5e-3})
    folder = write_dataset(tmp_path / "data", "waves", tree)
    said = refused("close-loop", folder, "--out", tmp_path / "out")
    assert "predict_s has 0 samples a pass of the declared bar" in said


# --- command lines --------------------------------------------------------------------------------

COMMANDS = app.commands
VALUES = st.one_of(
    NASTY_NUMBERS.map(str),
    NASTY_TEXT.filter(lambda text: "\0" not in text),
    st.sampled_from(["1e6", "0.02", "beam", "solid", "nitsche", "2", "true", "paper", "peers"]),
)


@st.composite
def command_lines(draw):
    """A command with options of its own, some of another's, and values of all kinds."""
    name = draw(st.sampled_from(sorted(COMMANDS)))
    options = [each for each in COMMANDS[name].params if isinstance(each, click.Option)]
    words = [name]
    for _ in range(draw(st.integers(0, 4))):
        option = draw(st.sampled_from(options))
        flag = draw(st.sampled_from([*option.opts, *option.secondary_opts]))
        if flag in ("--out", "--truth", "--config", "--help", "-h", "--debug"):
            continue
        words.append(flag)
        if not option.is_flag or draw(st.integers(0, 9)) == 0:
            words += [draw(VALUES) for _ in range(max(option.nargs, 1))]
    if draw(st.booleans()):
        words.append(draw(VALUES))
    return words


@SOME_OR_MANY
def test_any_command_line_is_refused_or_sound(marked, count):
    def promises(words):
        with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
            status, _, lines = run(*words)
            message = kept_promise(status, lines)
            if marked:
                marked.clear()
            else:
                assert status == 2, (words, lines[-1:])
                assert message
            made = {str(path) for path in Path().rglob("*")}
            assert all(path.split("/")[0] == "results" for path in made), made

    tried(
        count,
        promises,
        (["drop", "--kn", "1" + "0" * 400],),
        (["drop", "--surface", "\ud800"],),
        (["view", "\udcff"],),
        (["close-loop", "x" * 5000],),
        (["scatter", "--surface", "."],),
        words=command_lines(),
    )


# --- results that are read again ------------------------------------------------------------------

RESULTS = st.one_of(
    st.binary(max_size=40),
    st.recursive(
        st.one_of(st.none(), NASTY_NUMBERS.filter(lambda x: x == x), NASTY_TEXT),
        lambda inner: st.one_of(
            st.lists(inner, max_size=3),
            st.dictionaries(
                st.one_of(st.sampled_from(["inputs", "model", "version", "kn_N_m"]), NASTY_TEXT),
                inner,
                max_size=4,
            ),
        ),
    ).map(lambda tree: json.dumps(tree).encode()),
)


def test_any_result_is_refused_or_read(marked):
    def promises(content, how):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "result.json"
            path.write_bytes(content)
            arguments = {
                "view": ["view", folder],
                "config": ["drop", "--config", path, "--out", Path(folder) / "out"],
                "resume": ["drop", "--resume", "--out", folder],
            }[how]
            status, _, lines = run(*arguments)
            kept_promise(status, lines)
            marked.clear()
            assert status == 2
            assert path.read_bytes() == content

    tried(
        150,
        promises,
        (b"[" * 100_000, "view"),
        (b"[" * 100_000, "resume"),
        (b'{"inputs": {"kn_N_m": 1' + b"0" * 5000 + b"}}", "config"),
        content=RESULTS,
        how=st.sampled_from(["view", "config", "resume"]),
    )


# --- pages ----------------------------------------------------------------------------------------


def test_a_title_is_text_and_nothing_else(tmp_path):
    made = {}
    for name, title in (("plain", "Drops"), ("nasty", TITLE)):
        about = {"kind": "drops", "title": title, "source": title, "licence": title}
        data = write_dataset(tmp_path / name, "drops", manifest("drops", dataset=about))
        assert run("calibrate", data, "--out", tmp_path / f"{name}-out")[0] == 0
        made[name] = Page((tmp_path / f"{name}-out" / "report.html").read_text())
    plain, nasty = ([(tag, tuple(has)) for tag, has in page.tags] for page in made.values())
    assert nasty == plain
    assert any(TITLE in text for text in made["nasty"].text)
    for path in (tmp_path / "nasty-out").rglob("*.svg"):
        assert "<script" not in path.read_text()
        assert "onerror" not in path.read_text()
    assert {path.name for path in (tmp_path / "plain-out").rglob("*")} == {
        path.name for path in (tmp_path / "nasty-out").rglob("*")
    }


def test_a_spreadsheet_computes_nothing_of_a_table():
    cells = ["=1+1", "+1", "-1", "@x", "plain"]
    table = Table("t", "T", (Column("a", "A"), Column("b", "B")), [(cell, -1.0) for cell in cells])
    rows = table.csv_text().splitlines()[1:]
    assert rows == ["'=1+1,-1.0", "'+1,-1.0", "'-1,-1.0", "'@x,-1.0", "plain,-1.0"]


def test_the_toml_that_these_tests_write_is_toml(tmp_path):
    tree = {"a": {"b\n": [1, {"c": "\x7f"}]}, "d": True, "e": 10**400}
    assert tomllib.loads(document(tree)) == tree
