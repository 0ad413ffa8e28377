"""The benchmark of ranks measures what it says, and holds it against the right run."""

from __future__ import annotations

import csv
import json

import pytest
from benchmarks import ranks
from benchmarks.apart import apart
from benchmarks.ranks import Job, Memory, jobs, run_ranks

from bristle.solver.errors import ComputationError, InputError

TINY = (1, 2, 12)


def test_every_job_has_its_base_among_the_jobs():
    for most in (2, 3, 4, 8):
        todo = jobs(most)
        assert {job.base for job in todo} <= set(todo)
        assert max(job.ranks for job in todo if job.kind != "mixed") <= most


def test_an_ideal_job_is_fully_efficient():
    cells = TINY
    one, two = Job("one", 1, 1, 1, cells), Job("one", 2, 2, 1, cells)
    few, many = Job("many", 1, 1, 3, cells), Job("many", 2, 1, 6, cells)
    assert (two.base, many.base) == (one, few)
    times = {
        one: [{"total_s": 8.0, "march_s": 6.0}],
        two: [{"total_s": 5.0, "march_s": 3.0}, {"total_s": 4.0, "march_s": 4.0}],
        few: [{"total_s": 8.0, "march_s": 6.0}],
        many: [{"total_s": 10.0, "march_s": 6.0}],
    }
    memory = Memory(2, 9e9, 1e10, 8e9, 1e10)
    lines = list(ranks._lines(times, 2, memory))
    assert [line.memory_allows for line in lines] == [None, 0.8, None, 0.8]
    assert [line.efficiency for line in lines] == [1.0, 1.0, 1.0, 0.8]
    assert [line.efficiency_march for line in lines] == [1.0, 1.0, 1.0, 1.0]


def test_under_mpirun_it_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    with pytest.raises(InputError, match="mpirun"):
        run_ranks(tmp_path)


@pytest.mark.serial
def test_a_job_that_fails_says_why():
    with pytest.raises(ComputationError, match="a job on 1 ranks failed"):
        apart(Job("one", 1, 1, 1, (0, 1, 1)).call, 1)


@pytest.mark.serial
@pytest.mark.campaign
def test_the_benchmark_writes_what_it_prints(tmp_path):
    text = run_ranks(tmp_path, repeats=1, most=2, large=TINY, small=TINY)
    rows = list(csv.DictReader((tmp_path / "ranks.csv").open()))
    document = json.loads((tmp_path / "ranks.json").read_text())
    assert [row["kind"] for row in rows] == ["one", "one", "many", "many", "mixed", "mixed"]
    assert [int(row["ranks"]) for row in rows] == [1, 2, 1, 2, 2, 4]
    assert len(document["ranks"]) == len(rows)
    # every case of a kind takes the same steps, whoever computes it
    steps = {job["runs"][0]["steps"] / job["cases"] for job in document["all_times"]}
    assert len(steps) == 1
    assert document["machine"]["latency_s"] > 0.0
    assert min(document["memory"].values()) > 0.0
    html = (tmp_path / "report.html").read_text()
    assert "What more ranks gain" in html
    assert f"bristle bench ranks --repeats 1 --most 2 --out {tmp_path}" in html
    assert all(f"{float(row['total_s']):.3g}" in text for row in rows)
