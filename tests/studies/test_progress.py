"""Long work says how far it is and how long it takes yet, on a terminal and elsewhere."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys

import numpy as np
import pytest
from commands import environment

from bristle.solver import paper
from bristle.solver.bristle import Bristle
from bristle.studies.inputs.config import DropInputs
from bristle.studies.running import progress as module
from bristle.studies.running.cases import run_case
from bristle.studies.running.progress import duration, logged_to_terminal, progress
from bristle.studies.running.steps import Watched, steps_of_contact

pytestmark = [pytest.mark.serial, pytest.mark.usefixtures("no_pictures")]

LONG_WORK = """
import time
from bristle.studies.running.progress import logged_to_terminal, progress, working
with logged_to_terminal():
    with working("getting ready"):
        time.sleep(0.3)
    with progress("pieces", 20) as advance:
        for _ in range(20):
            time.sleep(0.06)
            advance()
"""


def test_without_a_terminal_there_are_plain_lines_with_the_time_left(monkeypatch, capsys):
    clock = iter([0.0, 30.0, 30.0, 30.0, 31.0, 60.0, 60.0])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(module, "PLAIN_EVERY_S", 10.0)
    with logged_to_terminal(), progress("sweep", 12, done=2) as advance:
        advance()  # after 30 s, with all that is built before: no measure of the others
        advance()  # a second later: too soon to say
        advance(2)  # after 60 s: three took 30, so six more take 60
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "sweep: 2 of 12",
        "sweep: 3 of 12",
        "sweep: 6 of 12, about 60 s left",
    ]


def test_of_pieces_that_are_not_alike_no_time_is_told(monkeypatch, capsys):
    """The first four took 40 s, which says nothing of the other eight."""
    clock = iter(10.0 * i for i in range(20))
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(module, "PLAIN_EVERY_S", 15.0)
    with logged_to_terminal(), progress("effects", 12, alike=False) as advance:
        for _ in range(4):
            advance()
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) > 2
    assert not any("left" in line for line in lines)


def test_words_on_how_things_stand_come_before_the_time_left(monkeypatch, capsys):
    clock = iter([0.0, 0.0, 0.0, 30.0, 30.0])
    monkeypatch.setattr(module.time, "monotonic", lambda: next(clock))
    with logged_to_terminal(), progress("brush", 4) as advance:
        advance(words="force 1 N")
        advance(words="force 2 N")
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["brush: 0 of 4", "brush: 2 of 4, force 2 N, about 60 s left"]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "about 1 s"), (80.0, "about 80 s"), (150.0, "about 2 min"), (9000.0, "about 2 h")],
)
def test_a_time_is_said_as_a_person_does(seconds, words):
    assert duration(seconds) == words


def test_on_a_terminal_there_is_a_bar_with_the_time_left():
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", LONG_WORK],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env=environment() | {"TERM": "xterm", "COLUMNS": "100"},
    )
    os.close(theirs)
    shown = b""
    while True:
        try:
            some = os.read(ours, 4096)
        except OSError:  # the terminal has gone with its last user
            break
        if not some:
            break
        shown += some
    os.close(ours)
    assert process.wait() == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode())
    assert "getting ready" in text
    counts = [int(n) for n in re.findall(r"pieces.*?(\d+)/20", text)]
    assert counts == sorted(counts)
    assert counts[-1] == 20
    assert re.search(r"/20 0:00:0\d left 0:00:0\d", text)


@pytest.mark.parametrize("kn_N_m", [1e5, 2e6, 1e8])
def test_contact_takes_about_the_steps_that_are_foretold(kn_N_m):
    result, _ = run_case(DropInputs(kn_N_m=kn_N_m))
    foretold = steps_of_contact(Bristle(), kn_N_m, paper.ITS_S)
    assert foretold == pytest.approx(result.contact_time_s / paper.ITS_S, rel=0.3, abs=2)


class At:
    """A state of which only the time is asked."""

    def __init__(self, t_s: float) -> None:
        self.t_s = t_s


class Kept:
    """A mark of which only the number of steps is asked."""

    steps = 7


def test_every_step_is_told_once_also_of_a_march_that_goes_on():
    told: list[int] = []
    watched = Watched(1e-5, lambda count=1: told.append(count))
    for step in range(4):
        watched(At(0.1 + step * 1e-5), np.zeros(3))
    assert sum(told) == 3
    again: list[int] = []
    watched = Watched(1e-5, lambda count=1: again.append(count))
    watched.recall(Kept(), At(0.1 + 7e-5))
    watched(At(0.1 + 8e-5), np.zeros(3))
    assert again == [7, 1]
    assert watched.memory() == {}
