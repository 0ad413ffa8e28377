"""The program keeps its promise whatever configuration, dataset or command line it is given.

Thousands of each in the campaign, some of each always.
"""

import json
import os
import sys
import tempfile
import tomllib
from html.parser import HTMLParser
from pathlib import Path

import click
import pytest
from hostile import (
    NASTY_NUMBERS,
    NASTY_TEXT,
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
from bristle.studies.loop.kinds.falls.record import read_falls
from bristle.studies.loop.kinds.forces.record import read_forces
from bristle.studies.loop.kinds.tracks.record import read_tracks
from bristle.studies.loop.kinds.waves.record import read_waves
from bristle.studies.mesh import run as mesh_study
from bristle.studies.report.page import Column, Table
from bristle.studies.reproduce import run as reproduce_study
from bristle.studies.scatter import run as scatter_study

pytestmark = pytest.mark.serial

READERS = {
    "drops": read_drops,
    "tracks": read_tracks,
    "forces": read_forces,
    "waves": read_waves,
    "falls": read_falls,
}
# Four falls, a sample every five minutes.
SPARSE = "".join(f"{fall},{300 * k},0\n" for fall in range(1, 5) for k in range(30))
TITLE = "<script>alert(1)</script>&\"'<img src=x onerror=alert(2)>"


def tried(count):
    """So many cases, shrunk and remembered nowhere."""
    return settings(
        max_examples=count,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )


class Reached(Exception):
    """The computing would begin here."""


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


def promises_of_a_configuration(content, command, seen):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.toml"
        path.write_bytes(content)
        status, _, lines = run(command, "--config", path, "--out", Path(folder) / "out")
        message = kept_promise(status, lines)
        assert status == 2
        if seen:
            assert message == "reached"
            seen.clear()
        else:
            assert str(path) in message or message.startswith("--")
            assert not (Path(folder) / "out").exists()
        assert {each.name for each in Path(folder).iterdir()} <= {"config.toml", "out"}


@given(content=configurations(), command=st.sampled_from(STUDIES))
@tried(150)
@example(b"a = " + b"[" * 100_000, "drop")
@example(b"kn = 0x1" + b"0" * 5000, "drop")
@example(b"kn = 1" + b"0" * 5000, "drop")
@example(b"kn = -1e400", "sweep")
@example(b"\xff\xfe", "drop")
@example(b"effect = [{}]", "drop")
@example(b'"\\u001b[2J" = 1', "drop")
def test_any_configuration_is_refused_or_sound(marked, content, command):
    promises_of_a_configuration(content, command, marked)


@pytest.mark.campaign
@given(content=configurations(), command=st.sampled_from(STUDIES))
@tried(5000)
def test_thousands_of_configurations(marked, content, command):
    promises_of_a_configuration(content, command, marked)


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


def promises_of_a_dataset(kind, files):
    with tempfile.TemporaryDirectory() as name:
        folder = write_files(Path(name) / "data", files)
        read, told = None, ""
        try:
            read = READERS[kind](folder)
        except InputError as error:
            told = str(error)
        assert str(folder) in told or read.manifest.kind == kind


@given(data=st.data(), kind=st.sampled_from(list(TABLES)))
@tried(150)
def test_any_dataset_is_refused_or_sound(data, kind):
    promises_of_a_dataset(kind, data.draw(hostile_datasets(kind)))


@pytest.mark.campaign
@pytest.mark.parametrize("kind", list(TABLES))
@given(data=st.data())
@tried(2000)
def test_thousands_of_datasets(kind, data):
    promises_of_a_dataset(kind, data.draw(hostile_datasets(kind)))


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


@pytest.mark.parametrize(
    ("kind", "table", "says"),
    [
        ("drops", "drop,y0_mm,y1_mm\n", "no rows under the columns"),
        ("drops", "drop,y0_mm,y1_mm\n1,1_0,5\n2,10,5\n3,10,5\n", ":2: y0_mm is no number: '1_0'"),
        ("drops", "drop,y0_mm,y1_mm\n1,٣,5\n2,10,5\n3,10,5\n", ":2: y0_mm is no number"),
        ("drops", "drop,y0_mm,y1_mm\n1,1e308,5\n2,10,5\n3,10,5\n", "at most 1e.12 in size"),
        ("drops", f'drop,y0_mm,y1_mm\n1,"{"9" * 200_000}",5\n', ":2: no row of a CSV table"),
        ("falls", "fall,t_s,a_m_s2\n" + SPARSE, ":2: fall 1 has 30 samples in 8700 s; 40 a second"),
    ],
    ids=["empty", "notation", "digits", "huge", "field", "sparse"],
)
def test_a_table_is_refused_by_its_line(tmp_path, kind, table, says):
    folder = write_dataset(tmp_path / "data", kind, table=table)
    with pytest.raises(InputError, match=says):
        READERS[kind](folder)


@pytest.mark.parametrize(
    ("part", "values", "says"),
    [
        ("contact", {"kn_N_m": 16**5000}, "kn_N_m must be a finite number, not a value too long"),
        ("contact", {"kn_N_m": 1e300}, "kn_N_m must lie between"),
        ("body", {"length_m": 5e-324}, "length_m: must be greater"),
        ("body", {"poisson_ratio": -2.0}, "poisson_ratio: must be greater"),
        ("measurement", {"file": "drops.csv", "sigma_y_mm": 0.0}, "sigma_y_mm must be positive"),
        ("measurement", {"file": "drops.csv", "sigma_y_mm": 1e-300}, "sigma_y_mm must lie between"),
        ("dataset", {"kind": "drops", "title": 5}, "title must be a text"),
        ("dataset", {"kind": "drops", "title": "x" * 5000}, "title must be a text"),
    ],
    ids=lambda value: str(value)[:20] if isinstance(value, str) else "",
)
def test_a_declaration_is_refused_by_its_line(tmp_path, part, values, says):
    folder = write_dataset(tmp_path / "data", "drops", manifest("drops", **{part: values}))
    with pytest.raises(InputError, match=rf"dataset.toml:\d+: {says}"):
        read_manifest(folder)


@pytest.mark.parametrize("unit", ["$\\frac{$", "<b>V</b>", 5, "V" * 50, ""])
def test_a_unit_is_one_that_labels_can_show(tmp_path, unit):
    measurement = {**manifest("waves")["measurement"], "unit": unit}
    folder = write_dataset(tmp_path / "data", "waves", manifest("waves", measurement=measurement))
    with pytest.raises(InputError, match="unit must be a unit such as"):
        read_waves(folder)


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


def promises_of_a_command_line(words, seen):
    with tempfile.TemporaryDirectory() as name:
        folder, before = Path(name), Path.cwd()
        os.chdir(folder)
        try:
            status, _, lines = run(*words)
        finally:
            os.chdir(before)
        message = kept_promise(status, lines)
        if seen:
            seen.clear()
        else:
            assert status == 2, (words, lines[-1:])
            assert message
        made = {str(path.relative_to(folder)) for path in folder.rglob("*")}
        assert all(path.split("/")[0] == "results" for path in made), made


@given(words=command_lines())
@tried(150)
@example(["drop", "--kn", "1" + "0" * 400])
@example(["drop", "--surface", "\ud800"])
@example(["view", "\udcff"])
@example(["close-loop", "x" * 5000])
@example(["scatter", "--surface", "."])
def test_any_command_line_is_refused_or_sound(marked, words):
    promises_of_a_command_line(words, marked)


@pytest.mark.campaign
@given(words=command_lines())
@tried(5000)
def test_thousands_of_command_lines(marked, words):
    promises_of_a_command_line(words, marked)


@given(numbers=st.dictionaries(st.sampled_from(["--kn", "--height", "--gravity"]), NASTY_NUMBERS))
@tried(40)
def test_what_is_computed_of_any_numbers_is_sound(numbers):
    with tempfile.TemporaryDirectory() as folder:
        options = [f"{name}={value}" for name, value in numbers.items()]
        status, _, lines = run("drop", "--model", "analytic", *options, "--out", folder)
        kept_promise(status, lines)
        if status == 0:
            document = json.loads((Path(folder) / "result.json").read_text())
            assert document["peak_force_N"] > 0.0


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


@given(content=RESULTS, how=st.sampled_from(["view", "config", "resume"]))
@tried(150)
@example(b"[" * 100_000, "view")
@example(b"[" * 100_000, "resume")
@example(b'{"inputs": {"kn_N_m": 1' + b"0" * 5000 + b"}}", "config")
def test_any_result_is_refused_or_read(marked, content, how):
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


# --- pages ----------------------------------------------------------------------------------------


class _Elements(HTMLParser):
    """Every element of a page, with the names of its attributes, and all that is text."""

    def __init__(self):
        super().__init__()
        self.found, self.text = [], []

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, tuple(name for name, _ in attributes)))

    def handle_data(self, data):
        self.text.append(data)


def elements(path):
    parser = _Elements()
    parser.feed(path.read_text())
    return parser


def test_a_title_is_text_and_nothing_else(tmp_path):
    made = {}
    for name, title in (("plain", "Drops"), ("nasty", TITLE)):
        about = {"kind": "drops", "title": title, "source": title, "licence": title}
        data = write_dataset(tmp_path / name, "drops", manifest("drops", dataset=about))
        assert run("calibrate", data, "--out", tmp_path / f"{name}-out")[0] == 0
        made[name] = elements(tmp_path / f"{name}-out" / "report.html")
    assert made["nasty"].found == made["plain"].found
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
