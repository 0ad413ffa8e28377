"""The command line ends as promised: status, last line, and nothing lost."""

import json
import math
import os
import re
import shlex
import signal
import subprocess
import sys
import time

import pytest
from commands import bristle, environment, mpirun, python
from hostile import ERROR, NASTY_NUMBERS, refused, run
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from bristle.solver.errors import ComputationError
from bristle.studies import drop as drop_study
from bristle.studies.inputs.fields import DROP_FLAGS
from bristle.studies.running.mark import MARK

pytestmark = pytest.mark.serial

COMMANDS = ("reproduce", "drop", "sweep", "its", "mesh", "brush", "calibrate", "close-loop", "view")
# the number of steps and elements decides how long a run takes, so it stays out of the lottery
NUMERIC = [
    flag
    for flag in DROP_FLAGS
    if flag.kind in (float, int) and flag.name not in ("its", "elements")
]


def test_without_arguments_it_says_what_to_do_next():
    status, out, _ = run()
    assert status == 0
    assert all(command in out for command in COMMANDS)
    words = " ".join(out.split())
    steps = ["bristle drop:", "bristle view results/drop", "bristle reproduce", "close-loop FOLDER"]
    places = [words.index(step) for step in steps]
    assert places == sorted(places)
    assert "results/reproduce/report.html" in words


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_shows_an_example_and_no_default_that_is_none(command):
    status, out, _ = run(command, "--help")
    assert status == 0
    assert re.search(rf"Example: .*bristle {command}", " ".join(out.split()))
    assert "None]" not in out


def test_every_option_of_help_is_accepted_by_name():
    _, out, _ = run("drop", "--help")
    assert {flag.option for flag in DROP_FLAGS} <= set(re.findall(r"--[a-z0-9-]+", out))


# By command: words, and how what is said of them begins.
WRONG = {
    "drop": [
        ("--kn abc", "--kn: 'abc' is not a valid float"),
        ("--knn 1", "--knn: there is no such option; did you mean --kn"),
        ("--kn", "--kn: requires an argument"),
        ("--kn -1", "--kn: must be greater"),
        ("--kn nan", "--kn: must be"),
        ("--kn inf", "--kn: penalty needs a finite"),
        ("--height inf", "--height: must be a finite"),
        ("--its 0", "--its: must be greater"),
        ("--model shell", "--model: 'shell' is not one of"),
        ("--cells 1 2", "--cells"),
        ("--cells 1 2 x", "--cells: 'x' is not a valid integer"),
        ("--elements 1.5", "--elements: '1.5' is not a valid integer"),
        ("--diameter 1e-3 --width 1e-3", "--width: a round wire"),
        ("--tilt 81", "--tilt: must be less than or equal to 80"),
        ("--slope -61", "--slope: must be greater than or equal to -60"),
        ("--tilt 50 --slope -50", "--tilt: tilt and slope together lean the bristle"),
        ("--model analytic --tilt 2", "--tilt: the analytic model is a mass on"),
        ("--tip-shape round", "--tip-shape: tip shape 'round' is not known"),
        ("--keep nan", "Invalid value for --keep: nan is no number"),
        ("--contact-points 2", "--contact-points: must be greater"),
        ("--effect air_drag:cf=1", "--effect: air_drag has no parameter 'cf'"),
        ("--effect air_drag:cd=-1", "--effect: air_drag: cd must lie between"),
        ("--effect wear --effect wear", "--effect: names wear twice"),
        ("--effect adhesion --effect plastic_contact", "--effect: two of the effects change the "),
        ("--effect adhesion --model analytic", "--effect: adhesion is not for"),
        ("--effect hysteretic_damping --model solid", "--effect: hysteretic_damping b"),
        ("--effect hunt_crossley --contact nitsche", "--effect: a contact law of its"),
        ("--effect gravity_waves", "--effect: names an unknown effect"),
        ("--until tomorrow", "--until: must be impact, rebound or a time"),
        ("--model solid --tip point", "--tip: the solid meets"),
        ("--config nowhere.toml", "--config nowhere.toml: cannot be read"),
        ("--out=", "--out: is empty"),
        ("extra", "extra: not expected here"),
        ("'one\ntwo'", "one two: not expected here"),
    ],
    "brush": [
        ("--penetration 0.34", "--penetration: goes beyond the bristles' length of 0.3365 m"),
        ("--penetration 0.33", "--penetration: takes the clamps below the surface"),
        ("--count 2", "--count: a single bristle is 1"),
        ("--layout row --count 2 --spacing 2e-3", "--spacing: bristles 0 and 1 ov"),
        ("--layout ring --count 40 --flare -60", "--spacing: bristles 0 and"),
        ("--layout row --flare 5", "--flare: is for a ring or a cup"),
        ("--layout ring --count 12 --tufts 3", "--tufts: is for a cup"),
        ("--radius 0.2", "--radius: is for a ring or a cup"),
        ("--rows 2", "--rows: is for more than one bristle"),
        ("--motion slide", "--motion: must be press, slide:speed=M/S"),
        ("--motion slide:speed=fast", "--motion: must give 'speed' a finite number"),
        ("--motion rotate:rpm=nan", "--motion: must give 'rpm' a finite number"),
        ("--motion file:nowhere.csv", "--motion: "),
        ("--friction-static 0.1", "--friction-static: is less than the 0.5 of --friction"),
        ("--every 1e-7 --until 10", "--every: makes more than 100,000 rows"),
        ("--length-std 0.1 --length 0.2", "--length-std: is more than a third"),
        ("--diameter 1e-3 --width 1e-3", "--diameter: a round wire"),
        ("--elements 1", "--elements: must be greater"),
        ("--kn 1e13", "--kn: must be 1e+12 N/m or less, or inf"),
    ],
    "sweep": [
        ("--kn 1e5;2e6", "--kn: must be numbers separated by commas"),
        ("--models beam,shell", "--models: must be"),
        ("--tilt 0,x", "--tilt: must be numbers separated by commas; 'x' is none"),
        ("--tilt 0,", "--tilt: must be numbers separated by commas; '' is none"),
        ("--tilt 0,85", "--tilt: must be less than or equal to 80"),
        ("--elements 4,2.5", "--elements: must be a whole number, not 2.5"),
        ("--elements inf,4", "--elements: must be"),
        ("--elements nan", "--elements: must be"),
        (
            "--contact penalty,glue",
            "--contact: must be 'penalty', 'augmented' or 'nitsche', not 'glue'",
        ),
    ],
    "scatter": [
        ("--material steel", "--material: there is no such option here, only in drop, "),
        ("--drop 3", "--drop: there is no such option; did you mean --drops?"),
    ],
    "its": [("--its 1e-5,-1", "--its: must be greater")],
    "mesh": [
        ("--cells 0 1 1", "--cells: must be greater"),
        ("--kn 1", "--kn: there is no such option here, only in drop, "),
    ],
    "calibrate": [("", "DATASET: is missing")],
    "view": [
        ("nowhere", "nowhere: there is no such folder"),
        ("nowhere --out=", "--out: is empty"),
    ],
    "bench": [
        ("speed", "speed: there is peers, "),
        ("--largest 3", "--largest: belongs to bench sizes, not to bench peers"),
    ],
    "fly": [("", "fly: there is no such command")],
    "--speed": [("", "--speed: there is no such option")],
}


@pytest.mark.parametrize(
    ("command", "words", "says"),
    [(command, *case) for command, cases in WRONG.items() for case in cases],
    ids=lambda each: each.replace("\n", " "),
)
def test_wrong_input_ends_with_2_and_the_option(command, words, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert refused(command, *shlex.split(words)).startswith(says)
    assert not list(tmp_path.iterdir())


def test_the_same_in_a_process_of_its_own(tmp_path):
    done = bristle("drop", "--kn", "-1", "--out", tmp_path / "out")
    assert done.returncode == 2
    assert done.stdout == ""
    assert ERROR.match(done.stderr.splitlines()[-1])


FLAGS = {flag.option: flag for flag in NUMERIC}
VALUES = st.one_of(
    NASTY_NUMBERS.map(str),
    st.floats().map(repr),
    st.floats(1e-9, 1e9).map(repr),
    st.integers(-10, 10**12).map(str),
    st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), max_size=6),
)


@example([(FLAGS["--friction"], "5e-324"), (FLAGS["--tilt"], "1")])
@given(st.lists(st.tuples(st.sampled_from(NUMERIC), VALUES), min_size=1, max_size=3))
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_values_end_with_a_sound_result_or_one_line(tmp_path, pairs):
    options = [f"{flag.option}={value}" for flag, value in pairs]
    # few steps and cells, whatever is asked for: this is about the input
    small = ["--elements=2", "--cells", "1", "1", "20", "--until=impact", "--its=1e-5"]
    status, _, lines = run("drop", *small, *options, "--out", tmp_path / "out")
    assert "Traceback" not in "".join(lines)
    if status == 0:
        document = json.loads((tmp_path / "out" / "result.json").read_text())
        for flag, value in dict(pairs).items():
            assert document["inputs"][flag.field] == pytest.approx(float(value))
        assert document["peak_force_N"] > 0.0
        assert document["impact_speed_m_s"] > 0.0
        return
    assert ERROR.match(lines[-1])
    assert "unexpected" not in lines[-1]
    if status == 2:
        named = lines[-1].removeprefix("bristle: error: ").split(":")[0]
        assert named in {flag.option for flag in DROP_FLAGS}
    else:
        assert status == 1


def test_a_drop_says_what_it_found_and_where(tmp_path):
    status, out, _ = run("drop", "--out", tmp_path / "a", "--kn", "1e6", "--height", "0.02")
    assert status == 0
    document = json.loads((tmp_path / "a/result.json").read_text())
    assert f"{document['rebound_ratio']:.4g}" in out
    assert str(tmp_path / "a" / "result.json") in out
    assert math.isclose(document["impact_speed_m_s"], math.sqrt(2 * 9.8 * 0.02))


def test_a_leaning_drop_says_what_it_found(tmp_path):
    status, out, lines = run("drop", "--tilt", "2", "--out", tmp_path / "a")
    assert status == 0
    assert not any("warning" in line for line in lines)
    document = json.loads((tmp_path / "a/result.json").read_text())
    shown = {line[:24].strip(): line[24:] for line in out.splitlines()}
    assert shown["touches"] == str(document["n_contacts"])
    assert float(shown["centre of mass y1/y0"]) == pytest.approx(
        document["cm_rebound_height_m"] / 0.05, rel=1e-3
    )
    assert float(shown["lost to friction"].split()[0]) == pytest.approx(
        1e6 * document["energy"]["friction_loss_J"], rel=1e-2
    )
    assert document["deflection"] == "second-order"
    assert document["energy"]["closure_relative"] < 1e-5
    _, upright, _ = run("drop", "--out", tmp_path / "b")
    assert "touches" not in upright
    assert "friction" not in upright
    assert "lost to" not in upright


def test_a_drop_says_what_its_contact_law_took(tmp_path):
    asked = "--model", "beam", "--effect", "plastic_contact:yield_N=20"
    _, out, _ = run("drop", *asked, "--out", tmp_path / "a")
    document = json.loads((tmp_path / "a/result.json").read_text())
    shown = {line[:24].strip(): line[24:] for line in out.splitlines()}
    taken_J = document["energy"]["contact_loss_J"]
    assert taken_J > 0.3 * document["energy"]["initial_J"]
    assert float(shown["lost to contact"].split()[0]) == pytest.approx(1e6 * taken_J, rel=1e-2)


def test_a_bristle_that_falls_over_ends_with_its_first_touches(tmp_path):
    status, _, _ = run("drop", "--tilt", "60", "--out", tmp_path / "out")
    assert status == 0
    document = json.loads((tmp_path / "out/result.json").read_text())
    assert document["cm_velocity_after_m_s"] < 0.0
    assert document["energy"]["closure_relative"] < 1e-9


@pytest.mark.parametrize("model", ["beam", "reduced"])
def test_a_result_repeats_itself(tmp_path, model):
    how = ("--model", model, "--elements", "6", "--cells", "1", "1", "20", "--kn", "3e6")
    run("drop", *how, "--until", "0.3", "--out", tmp_path / "a")
    status, _, _ = run("drop", "--config", tmp_path / "a/result.json", "--out", tmp_path / "b")
    assert status == 0
    a, b = (json.loads((tmp_path / name / "result.json").read_text()) for name in "ab")
    changing = {"wall_s", "peak_rss_MB"}
    assert {k: v for k, v in a.items() if k not in changing} == {
        k: v for k, v in b.items() if k not in changing
    }
    assert (tmp_path / "a/history.csv").read_text() == (tmp_path / "b/history.csv").read_text()


def test_resume_on_the_command_line(tmp_path):
    run("drop", "--out", tmp_path / "a")
    status, out, _ = run("drop", "--out", tmp_path / "a", "--resume")
    assert status == 0
    assert "nothing to do" in out
    message = refused("drop", "--out", tmp_path / "a", "--resume", "--height", "0.02")
    assert "--height is 0.05 there, 0.02 is asked for" in message


def test_the_default_folder_is_results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("drop")[0] == 0
    assert (tmp_path / "results/drop/result.json").exists()


def test_warnings_are_told_and_kept(tmp_path):
    _, _, lines = run("drop", "--kn", "1e8", "--out", tmp_path / "a")
    (told,) = [line for line in lines if line.startswith("bristle: warning: ")]
    (kept,) = json.loads((tmp_path / "a/result.json").read_text())["warnings"]
    assert told == f"bristle: warning: {kept}"


@pytest.mark.parametrize("where", ["global", "command"])
def test_debug_alone_shows_a_traceback(tmp_path, where):
    arguments = ["drop", "--kn", "-1", "--out", tmp_path / "out"]
    arguments.insert(0 if where == "global" else 1, "--debug")
    status, _, lines = run(*arguments)
    assert status == 2
    assert lines[0].startswith("Traceback")
    assert ERROR.match(lines[-1])


def test_what_nobody_foresaw_ends_with_1_and_a_hint(tmp_path, monkeypatch):
    def fail(*args, **kwargs):
        raise ZeroDivisionError("two\nlines")

    monkeypatch.setattr(drop_study, "_compute", fail)
    status, _, lines = run("drop", "--out", tmp_path / "out")
    assert status == 1
    expected = "ZeroDivisionError: two lines (unexpected: --debug shows where)"
    assert lines[-1] == f"bristle: error: {expected}"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_ends_with_130_and_leaves_the_old_result(tmp_path, number):
    out = tmp_path / "out"
    solid = ["drop", "--model", "solid", "--cells", "1", "1", "12", "--no-fields", "--out", out]
    assert run(*solid)[0] == 0  # and what runs compiled is compiled
    before = (out / "result.json").read_bytes()
    process = subprocess.Popen(
        [sys.executable, "-m", "bristle.studies.cli", *solid, "--its", "1e-8"],
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    assert "building" in process.stderr.readline()
    assert "contact" in process.stderr.readline()
    time.sleep(0.3)
    os.kill(process.pid, number)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors.splitlines()[-1] == "bristle: interrupted"
    assert (out / "result.json").read_bytes() == before
    assert sorted(path.name for path in out.iterdir()) == ["history.csv", "result.json", MARK]


def test_a_command_spells_the_inputs_of_an_error_as_its_options(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise ComputationError("the bristle falls over; end the drop before", inputs=("until",))

    monkeypatch.setattr(drop_study, "session_on", fail)
    status, _, lines = run("drop", "--model", "beam", "--out", tmp_path / "out")
    said = "bristle: error: the bristle falls over; end the drop before (--until)"
    assert (status, lines[-1]) == (1, said)


def test_each_study_is_a_script():
    """One after the other in one process, each as ``python3 -m`` runs it."""
    modules = ["drop", "sweep", "its", "mesh"]
    code = (
        "import runpy, sys; sys.argv = ['study', '--length', '-1']\n"
        f"for name in {modules}:\n"
        "    try: runpy.run_module('bristle.studies.' + name, run_name='__main__')\n"
        "    except SystemExit as end: print(name, end.code)"
    )
    done = python("-c", code)
    assert done.stdout.split("\n")[:-1] == [f"{name} 2" for name in modules]
    errors = [line for line in done.stderr.splitlines() if line.startswith("bristle: error: ")]
    assert all(line.startswith("bristle: error: --length: ") for line in errors)
    assert len(errors) == len(modules)


def test_on_two_ranks_one_speaks(tmp_path):
    solid = ["drop", "--model", "solid", "--cells", "1", "1", "10", "--no-fields", "--out"]
    done = mpirun(2, "-m", "bristle.studies.cli", *solid, tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("rebound ratio") == 1
    assert done.stderr.count("building") == 1
    assert json.loads((tmp_path / "out/result.json").read_text())["ranks"] == 2


def test_an_error_on_all_ranks_is_told_once(tmp_path):
    """Of values, of words, and of folders; the second command finds the job as it was before."""
    (tmp_path / "taken").write_text("")
    code = (
        "import sys; from mpi4py import MPI; from bristle.studies.cli import main\n"
        f"for words in ['--kn=-1', '--kn=x', '--out={tmp_path / 'taken'}']:\n"
        "    assert main(['drop', words]) == 2; sys.stderr.flush(); MPI.COMM_WORLD.Barrier()"
    )
    done = mpirun(2, "-c", code)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("bristle: error: ") == 3


LONE = """
import sys, time
import click
from bristle.solver.errors import ComputationError
from bristle.studies.command.ending import run
from bristle.studies.running import parallel
from mpi4py import MPI

parallel.GRACE_S = 0.5  # nobody else comes

@click.command()
def lone():
    if MPI.COMM_WORLD.rank == int(sys.argv[1]):
        raise ComputationError("this rank alone")
    MPI.COMM_WORLD.Barrier()

sys.exit(run(lone, []))
"""


@pytest.mark.parametrize("rank", [0, 1])
def test_a_rank_that_fails_alone_ends_the_job(rank):
    done = mpirun(2, "-c", LONE, rank, timeout_s=60.0)
    assert done.returncode == 1
    assert done.stderr.count("bristle: error: this rank alone") == 1
