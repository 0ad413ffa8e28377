"""Nothing is lost, half-written or hung when a run is killed, its disk fills, or a rank dies."""

import ast
import fcntl
import os
import random
import resource
import signal
import subprocess
from contextlib import contextmanager

import numpy as np
import pytest
from commands import LIVE, environment
from drawing import draw_nothing
from faults import (
    FULL_SOLID,
    ended,
    hidden,
    journal_lines,
    left_running,
    ranks_of,
    send,
    started,
    told,
    wait_for,
)
from hostile import kept_promise, refused, run, write_dataset
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bristle.solver import cache
from bristle.solver.errors import ComputationError, InputError
from bristle.studies.inputs.config import DropInputs
from bristle.studies.running import files, mark
from bristle.studies.running.journal import JOURNAL, Journal
from bristle.studies.running.mark import MARK
from bristle.studies.running.threads import in_threads

pytestmark = pytest.mark.serial

SMALL = ["--cells", "1", "1", "20"]
SWEEP = ["sweep", "--models", "beam", "--its", "1e-6", "--heights", "0.01,0.05"]


# --- files ----------------------------------------------------------------------------------------


def contents(folder):
    """What lies in a folder by its name, but for the mark."""
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in folder.rglob("*")
        if path.is_file() and path.name != MARK
    }


def write_all(out):
    files.write_atomically(out / "result.json", "new")
    files.write_atomically(out / "tables" / "a.csv", "new")
    with files.folder_in_place(out / "fields") as made:
        (made / "b").write_text("new")
    files.remove(out / "older.svg")


def earlier(out):
    with files.together(out):
        for name in ("result.json", "tables/a.csv", "older.svg"):
            files.write_atomically(out / name, "old")
    with files.folder_in_place(out / "fields") as made:  # a folder by itself
        (made / "c").write_text("old")
    for name in ("notes.txt", "fields/notes.txt"):
        (out / name).write_text("the user's")
    return contents(out)


def test_files_take_their_places_together(tmp_path):
    earlier(tmp_path)
    with files.together(tmp_path, "result.json"):
        write_all(tmp_path)
        assert (tmp_path / "result.json").read_text() == "old"
        with files.together(tmp_path, "report.html"):
            files.write_atomically(tmp_path / "report.html", "new")
        assert not (tmp_path / "report.html").exists()
    names = ("result.json", "tables/a.csv", "fields/b", "report.html")
    users = ("notes.txt", "fields/notes.txt")
    assert contents(tmp_path) == dict.fromkeys(names, "new") | dict.fromkeys(users, "the user's")
    assert hidden(tmp_path) == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, ComputationError("no"), OSError(28, "full")])
def test_or_none_of_them_does(tmp_path, error):
    before = earlier(tmp_path)

    def fail():
        with files.together(tmp_path, "result.json"):
            write_all(tmp_path)
            raise error

    with pytest.raises((KeyboardInterrupt, ComputationError)):
        fail()
    assert contents(tmp_path) == before
    assert hidden(tmp_path) == []


def test_what_stands_in_the_way_is_seen_before_anything_moves(tmp_path):
    before = earlier(tmp_path)
    (tmp_path / "z.csv").write_text("the user's")
    before |= contents(tmp_path)

    def write():
        with files.together(tmp_path, "result.json"):
            write_all(tmp_path)
            files.write_atomically(tmp_path / "z.csv", "new")

    with pytest.raises(InputError, match="z.csv: was not written by this program"):
        write()
    assert contents(tmp_path) == before


# --- journals, marks and the cache ----------------------------------------------------------------

CASES = {0: {"x": 0.1, "kn": float("inf")}, 1: {"x": float("nan"), "y": [1, 2]}, 2: {"x": None}}


def journal(folder):
    noted = Journal(folder, DropInputs())
    noted.begin()
    return {number: noted.add(number, found) for number, found in CASES.items()}


def test_a_journal_gives_back_what_was_noted(tmp_path):
    noted = journal(tmp_path)
    assert noted[0] == CASES[0]
    assert repr(Journal(tmp_path, DropInputs()).resume()) == repr(noted)


@given(st.data())
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_a_damaged_journal_gives_back_what_is_whole(tmp_path, data):
    noted = journal(tmp_path)
    path = tmp_path / JOURNAL
    content = bytearray(path.read_bytes())
    head = content.index(b"\n")
    at = data.draw(st.integers(0, len(content) - 1))
    how = data.draw(st.sampled_from(["flip", "cut", "insert"]))
    if how == "flip":
        content[at] ^= 1 << data.draw(st.integers(0, 7))
    elif how == "cut":
        del content[at:]
    else:
        content[at:at] = data.draw(st.binary(min_size=1, max_size=20))
    path.write_bytes(content)
    try:
        again = Journal(tmp_path, DropInputs()).resume()
    except InputError:  # the first line, without which nothing is known of the others
        assert at <= head
        return
    assert all(repr(noted[number]) == repr(found) for number, found in again.items())
    if how == "flip":
        assert len(again) >= 1


def test_a_full_disk_leaves_a_journal_whole(tmp_path, monkeypatch):
    noted = journal(tmp_path)
    full = Journal(tmp_path, DropInputs())
    before = (tmp_path / JOURNAL).read_bytes()

    def fail(descriptor):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", fail)
        with pytest.raises(ComputationError, match="cases.jsonl: cannot be written: No space"):
            full.add(3, {"x": 1.0})
    assert (tmp_path / JOURNAL).read_bytes() == before
    assert repr(Journal(tmp_path, DropInputs()).resume()) == repr(noted)


def test_a_garbled_file_of_the_cache_is_made_again(tmp_path, monkeypatch):
    """Whichever byte of it is wrong, and wherever it ends."""
    monkeypatch.setattr(cache, "_path", lambda key: tmp_path / "kept.npz")
    made = {"table": np.arange(12.0).reshape(3, 4), "kn": np.array(2e6)}
    cache.store("key", made)
    content = (tmp_path / "kept.npz").read_bytes()
    for at in range(len(content)):
        low, high = (bytes([content[at] ^ bit]) for bit in (1, 128))
        for garbled in (content[:at], *(content[:at] + x + content[at + 1 :] for x in (low, high))):
            (tmp_path / "kept.npz").write_bytes(garbled)
            found = cache.load("key")
            if found is not None:
                assert found.keys() == made.keys()
                assert all(np.array_equal(found[name], made[name]) for name in made)
    assert cache.cached("key", lambda: made).keys() == made.keys()
    assert cache.load("key") is not None
    assert hidden(tmp_path) == []


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"\x93NUMPY\x01\x00", b"text"])
def test_what_is_no_archive_is_made_again(tmp_path, monkeypatch, content):
    monkeypatch.setattr(cache, "_path", lambda key: tmp_path / "kept.npz")
    (tmp_path / "kept.npz").write_bytes(content)
    assert cache.load("key") is None


def test_a_cache_that_cannot_be_written_keeps_nothing(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr(cache, "_path", lambda key: tmp_path / "file" / "kept.npz")
    assert cache.cached("key", lambda: {"x": np.ones(2)})["x"].sum() == 2.0


def test_of_several_arrays_those_that_are_missing_are_made_together(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "_path", lambda key: tmp_path / f"{key}.npz")
    cache.store("b", {"x": np.array([2.0])})
    asked = []

    def make(missing):
        asked.append(missing)
        return [{"x": np.array([10.0 * i])} for i in missing]

    for _ in range(2):
        found = cache.cached_each(["a", "b", "c"], make)
        assert [float(each["x"][0]) for each in found] == [0.0, 2.0, 20.0]
    assert asked == [[0, 2]]


def test_threads_take_turns_and_give_what_one_would():
    """In order; also from within one of them, which would else wait for itself for ever."""
    assert list(in_threads(lambda i: i**2, range(20))) == [i**2 for i in range(20)]
    assert list(in_threads(lambda i: list(in_threads(str, range(i))), [3])) == [["0", "1", "2"]]
    with pytest.raises(ZeroDivisionError):
        list(in_threads(lambda i: 1 // i, [1, 0, 2]))
    assert list(in_threads(int, [1.5])) == [1]


def test_nothing_that_is_read_can_hold_code():
    """No pickles but between ranks, no arrays of objects, nothing that is evaluated but plugins."""
    for path in sorted((LIVE / "bristle").glob("*/**/*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = {alias.name for alias in getattr(node, "names", []) if hasattr(alias, "name")}
            names |= {getattr(node, "module", None) or ""}
            bad = names & {"pickle", "dill", "joblib", "shelve", "marshal", "yaml", "cPickle"}
            assert not bad or path.parts[-2:] == ("meshes", "collective.py"), path
            if not isinstance(node, ast.Call):
                continue
            called = ast.unparse(node.func)
            if path.parts[-2:] != ("effects", "outside.py"):
                assert called not in ("eval", "exec", "compile", "os.system"), path
            if called in ("np.load", "numpy.load"):
                (allowed,) = [each for each in node.keywords if each.arg == "allow_pickle"]
                assert ast.unparse(allowed.value) == "False", path


# --- disks and folders ----------------------------------------------------------------------------

WRITERS = {
    "drop": ["drop"],
    "sweep": ["sweep", "--models", "analytic", "--kn", "1e5,2e6", "--heights", "0.01"],
    "its": ["its", "--models", "analytic", "--kn", "1e5", "--its", "1e-4,1e-5,1e-6"],
    "brush": ["brush", "--elements", "3", "--until", "0.004", "--every", "0.001"],
    "calibrate": ["calibrate", "paper"],
}
ALL = {
    **WRITERS,
    "scatter": ["scatter", "--drops", "10", "--model", "beam"],
    "mesh": ["mesh", *SMALL],
    "reproduce": ["reproduce"],
    "synth": ["synth"],
    "peers": ["bench", "peers"],
}


@contextmanager
def files_no_larger(n_bytes):
    """A disk that takes so much of each file; Python has the signal ignored."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("name", WRITERS)
def test_a_disk_that_fills_leaves_what_was_there(tmp_path, name, monkeypatch):
    draw_nothing(monkeypatch)
    out = tmp_path / "out"
    assert run(*WRITERS[name], "--out", out)[0] == 0
    before = told(out)
    largest = max(path.stat().st_size for path in out.rglob("*") if path.is_file())
    with files_no_larger(largest // 2):
        status, _, lines = run(*WRITERS[name], "--out", out)
    assert status == 1
    assert str(out) in kept_promise(status, lines)
    assert "cannot be written: File too large" in lines[-1]
    assert hidden(out) == []
    after = told(out)
    for left in ("cases.jsonl", "cases.previous.jsonl"):
        before.pop(left, None), after.pop(left, None)
    assert after == before


@contextmanager
def mounted(folder, options):
    """A small disk of its own at ``folder``; skips where none may be mounted."""
    folder.mkdir(exist_ok=True)
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], capture_output=True, check=False
    )
    if done.returncode:
        pytest.skip("no disk can be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


@pytest.mark.parametrize("name", ["drop", "calibrate"])
def test_a_full_disk_is_named(tmp_path, name):
    with mounted(tmp_path / "disk", "size=16k") as disk:
        status, _, lines = run(*WRITERS[name], "--out", disk / "out")
        assert status == 1
        assert "No space left on device" in kept_promise(status, lines)
        assert str(disk / "out") in lines[-1]
        assert [path for path in disk.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("name", ALL)
def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path, name):
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        assert refused(*ALL[name], "--out", out).startswith(f"--out {out}: ")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize("name", ALL)
def test_a_disk_that_is_read_only_is_refused_at_once(tmp_path, name):
    with mounted(tmp_path / "disk", "size=16k,ro") as disk:
        assert refused(*ALL[name], "--out", disk).startswith(f"--out {disk}: cannot be written")


# --- readers that go away -------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["pipe", "full"])
def test_nobody_reads_what_is_said(tmp_path, how):
    """``bristle drop | head -0``, and ``bristle drop > /dev/full``."""
    read, write = os.pipe()
    os.close(read)
    if how == "full":
        os.close(write)
        write = os.open("/dev/full", os.O_WRONLY)
    process = started(["drop", "--model", "analytic", "--out", tmp_path / "out"], stdout=write)
    os.close(write)
    status, _, lines = ended(process)
    assert status == 1
    assert "standard output" in kept_promise(status, lines)
    assert (tmp_path / "out" / "result.json").exists()


@pytest.mark.parametrize("closed", ["<&- 2>&-", ">&- 2>&-"])
def test_streams_that_are_closed_harm_nothing(tmp_path, closed):
    command = f'exec "$0" -m bristle.studies.cli drop --out "$1" {closed}'
    done = subprocess.run(
        ["sh", "-c", command, os.sys.executable, tmp_path / "out"],
        capture_output=True,
        text=True,
        env=environment(),
        timeout=120,
        check=False,
    )
    assert done.returncode == 0
    assert (tmp_path / "out" / "result.json").exists()
    assert (">&-" in closed.split()) or "rebound ratio" in done.stdout
    assert "Traceback" not in done.stderr


# --- killed, and gone on --------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_sweep_goes_on_where_it_was_killed(tmp_path, number, whole_sweep):
    out = tmp_path / "out"
    process = started([*SWEEP, "--out", out])
    wait_for(lambda: journal_lines(out) >= 5, process)
    send(process, number)
    status, _, lines = ended(process)
    noted = journal_lines(out)
    assert 5 <= noted < 22
    assert not (out / "sweep.json").exists()
    if number != signal.SIGKILL:
        assert status == 130
        assert lines[-1] == "bristle: interrupted"
        assert hidden(out) == []
    status, said, _ = run(*SWEEP, "--out", out, "--resume")
    assert status == 0
    assert f"{noted} of 22 cases are there already" in said
    assert told(out) == whole_sweep
    assert hidden(out) == []


@pytest.fixture(scope="module")
def whole_sweep(tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep")
    assert run(*SWEEP, "--out", out)[0] == 0
    return told(out)


def test_a_second_signal_while_it_cleans_up_changes_nothing(tmp_path):
    """As `timeout` sends it, to the process and to its group."""
    process = started([*SWEEP, "--out", tmp_path])
    wait_for(lambda: journal_lines(tmp_path) >= 2, process)
    for _ in range(2):
        send(process, signal.SIGTERM)
    status, _, lines = ended(process)
    assert (status, lines[-1]) == (130, "bristle: interrupted")
    assert hidden(tmp_path) == []


def test_what_resume_reads_of_an_infinite_stiffness_is_what_was_computed(tmp_path):
    rigid = ["sweep", "--models", "beam", "--contact", "augmented", "--kn", "2e6,inf"]
    rigid += ["--heights", "0.01", "--out"]
    assert run(*rigid, tmp_path / "whole")[0] == 0
    whole = told(tmp_path / "whole")
    (tmp_path / "whole" / "sweep.json").unlink()
    assert run(*rigid, tmp_path / "whole", "--resume")[0] == 0
    assert told(tmp_path / "whole") == whole


def test_a_run_that_is_taken_up_waits_for_the_end_of_the_first(tmp_path, whole_sweep):
    """As ranks go on that have not heard yet that their mpirun was killed."""
    out = tmp_path / "out"
    first = started([*SWEEP, "--out", out])
    wait_for(lambda: journal_lines(out) >= 2, first)
    first.send_signal(signal.SIGSTOP)
    noted = journal_lines(out)
    again = started([*SWEEP, "--out", out, "--resume"])
    heard = again.stderr.readline()
    first.kill()
    first.communicate()
    status, said, _ = ended(again)
    assert status == 0
    assert heard == f"waiting for another run that writes into {out} …\n"
    assert f"{noted} of 22 cases are there already" in said
    assert told(out) == whole_sweep


def test_but_not_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(mark, "PATIENCE_S", 0.3)
    other = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(other, fcntl.LOCK_EX)
    drop = ["drop", "--model", "analytic", "--out", tmp_path]
    try:
        said = refused(*drop)
        assert said == f"--out {tmp_path}: another run is writing there"
        assert list(tmp_path.iterdir()) == []
    finally:
        os.close(other)
    for _ in range(2):  # and a command leaves the folder free
        assert run(*drop)[0] == 0


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_rank_that_dies_ends_the_job(tmp_path, number):
    scatter = ["scatter", "--model", "beam", "--drops", "4000", "--out", tmp_path]
    process = started(scatter, ranks=2)
    wait_for(lambda: journal_lines(tmp_path) >= 1, process)
    send(process, number, whom="rank")
    status, _, _ = ended(process, 60.0)
    assert status not in (0, None)
    assert not (tmp_path / "scatter.json").exists()


@pytest.mark.slow
def test_ranks_end_with_their_mpirun(tmp_path):
    """Whoever kills it leaves ranks that talk to each other and, at their end, to nobody."""
    process = started([*FULL_SOLID, "--its", "1e-7", "--out", tmp_path], ranks=2)
    wait_for(lambda: any(tmp_path.rglob("*.npz")), process)
    ranks = ranks_of(process)
    assert len(ranks) == 2
    process.kill()
    left = left_running(ranks)
    for rank in left:
        os.kill(rank, signal.SIGKILL)
    process.communicate()
    assert left == []


# --- campaign -------------------------------------------------------------------------------------

LONG = {
    "solid": [*FULL_SOLID, "--its", "1e-6"],
    "sweep": ["sweep", *SMALL, "--models", "beam,reduced,solid", "--kn", "1e5,2e6,1e8"],
    "its": ["its", *SMALL, "--models", "beam,reduced", "--kn", "1e5,2e6"],
    "scatter": ["scatter", *SMALL, "--drops", "1500"],
    "brush": ["brush", "--layout", "row", "--count", "20", "--keep", "0"],
    "synth": ["synth", "--drops", "300", "--effect", "air_drag:cd=1.1"],
    "close-loop": ["close-loop"],
}
RESUMABLE = ("solid", "sweep", "its", "scatter", "brush")
ROUNDS = 6


def command_of(name, folder, out):
    arguments = [*LONG[name], "--out", out]
    if name == "synth":
        arguments += ["--truth", folder / "truth.json"]
    if name == "close-loop":
        arguments.insert(1, folder / "data")
    return arguments


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("name", LONG)
def test_killed_at_any_moment_it_comes_to_the_same(tmp_path, name, ranks):
    write_dataset(tmp_path / "data", "drops")
    out = tmp_path / "out"
    status, _, lines = ended(started(command_of(name, tmp_path, out), ranks), 600.0)
    assert status == 0, lines
    out.rename(tmp_path / "whole")  # pages tell the command, with its folder
    whole = told(tmp_path / "whole")
    chance = random.Random(f"{name} {ranks}")
    for round_ in range(ROUNDS):
        number = [signal.SIGKILL, signal.SIGTERM, signal.SIGINT][round_ % 3]
        process = started(command_of(name, tmp_path, out), ranks)
        wait_for(lambda: False, process, chance.uniform(1.5, 12.0))
        if process.poll() is None:
            those = ranks_of(process) if ranks > 1 else []
            send(process, number)
            status, _, lines = ended(process, 120.0)
            assert left_running(those) == []
            if status == 0:  # the signal came when all was done
                assert number != signal.SIGKILL
                assert told(out) == whole
            elif ranks == 1 and number != signal.SIGKILL:
                assert (status, lines[-1]) == (130, "bristle: interrupted")
                assert hidden(out) == []
        more = ["--resume"] if name in RESUMABLE else []
        process = started([*command_of(name, tmp_path, out), *more], ranks)
        status, _, lines = ended(process, 600.0)
        assert status == 0, lines
        assert hidden(out) == []
        assert told(out) == whole
        if name in RESUMABLE:
            for path in sorted(out.rglob("*"), reverse=True):
                path.unlink() if path.is_file() else path.rmdir()
