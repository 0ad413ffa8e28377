"""Benchmarks measure what they say, and say what they measured."""

import csv
import json
import re
import sys
from dataclasses import replace

import pytest
from benchmarks import launch, peers, programs, ranks, sizes, step
from benchmarks.peers_points import Point, converged, reached
from benchmarks.programs import DAMPED, QUANTITIES, Setting
from benchmarks.records import Part
from commands import mpirun, python
from made_outcomes import growing, shared_out, steps

from bristle.solver.errors import InputError

pytestmark = pytest.mark.serial


def point(its_s: float, error: float, wall_s: float, further_s: float | None = None) -> Point:
    errors = dict.fromkeys(QUANTITIES, error)
    setting = Setting(DAMPED, (1, 1, 4), its_s)
    return Point("one", setting, {}, errors, wall_s, wall_s, wall_s, further_s, 100.0, 1)


def test_time_at_equal_error_follows_a_power_law():
    # error h², time 1/h + the rest: 1 % is at h = 0.1
    own = [point(h, h**2, 1.0 / h, 0.1 / h) for h in (0.4, 0.2, 0.05)]
    assert reached(own, 1e-2).time_s == pytest.approx(10.0)
    assert reached(own, 1e-2, further=True).time_s == pytest.approx(1.0)


def test_an_error_that_no_setting_comes_near_is_not_extrapolated():
    assert reached([point(0.4, 0.16, 2.5), point(0.2, 0.04, 5.0)], 1e-3).time_s is None
    assert reached([point(0.4, 0.16, 2.5)], 0.2, further=True).time_s is None


def test_an_error_that_was_small_by_luck_and_grows_again_does_not_count():
    own = [point(0.4, 0.001, 2.5), point(0.2, 0.04, 5.0), point(0.1, 0.001, 10.0)]
    assert 5.0 < reached(own, 1e-2).time_s < 10.0


def test_where_the_longest_its_is_near_enough_less_time_may_do():
    found = reached([point(0.4, 0.001, 2.5), point(0.2, 0.0005, 5.0)], 1e-2)
    assert (found.time_s, found.coarsest) == (2.5, True)


def test_the_converged_value_is_free_of_second_order_error():
    coarse, fine = (dict.fromkeys(QUANTITIES, 2.0 + 8.0 * h**2) for h in (0.1, 0.05))
    rod = dict.fromkeys(QUANTITIES, 2.002)
    for said in (converged(coarse, fine, rod), converged(coarse, fine, {})):
        assert said.values == pytest.approx(dict.fromkeys(QUANTITIES, 2.0))
    assert converged(coarse, fine, rod).unsure["peak_force_N"] == pytest.approx(1e-3)
    assert converged(coarse, fine, {}).unsure["peak_force_N"] == pytest.approx(1e-2)


def test_a_process_is_charged_for_its_own_memory_and_time(tmp_path):
    # from within a process that is large itself
    inner = [sys.executable, "-I", "-S", launch.__file__]
    script = f"""
import json, subprocess
own = bytearray(b"x") * 400_000_000
for name, code in (("small", "pass"), ("large", "x = bytearray(b'x') * 200_000_000"),
                   ("slow", "import time; time.sleep(0.5)"), ("wrong", "raise SystemExit(3)")):
    cost = r"{tmp_path}/" + name
    status = subprocess.run([*{inner!r}, cost, r"{sys.executable}", "-c", code]).returncode
    print(json.dumps([status, json.load(open(cost))]))
"""
    done = python("-c", script)
    assert done.returncode == 0, done.stderr
    small, large, slow, wrong = map(json.loads, done.stdout.splitlines())
    assert small[1]["peak_rss_MB"] < 100.0
    assert 200.0 < large[1]["peak_rss_MB"] < 300.0
    assert slow[1]["wall_s"] >= 0.5
    assert [each[0] for each in (small, large, slow, wrong)] == [0, 0, 0, 3]


def test_what_is_not_there_is_said(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    by_name = {each.name: each for each in programs.PROGRAMS}
    assert by_name["CalculiX"].absent().startswith("not installed")
    assert not by_name["scipy, plain"].absent()
    monkeypatch.setattr(programs, "REFERENCES", tmp_path)
    assert "tests/reference" in by_name["scipy, plain"].absent()
    assert not by_name["bristle, beam"].absent()


@pytest.mark.campaign
def test_peers_on_a_tiny_mesh(monkeypatch, tmp_path):
    few = [each for each in programs.PROGRAMS if each.name in ("bristle, beam", "scipy, plain")]
    broken = replace(few[0], name="broken", model="", script="impact.py")
    gone = replace(broken, name="gone", script="nothing.py")
    monkeypatch.setattr(peers, "PROGRAMS", (*few, broken, gone))
    block = peers.Block(DAMPED, (1, 1, 4), (1e-5, 5e-6))
    said = peers.run_peers(tmp_path, repeats=2, blocks=(block,))
    with (tmp_path / "peers.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["program"], float(row["its_us"])) for row in rows] == [
        (name, its) for name in ("bristle, beam", "scipy, plain") for its in (10.0, 5.0)
    ]
    for row in rows:
        assert float(row["wall_low_s"]) <= float(row["wall_s"]) <= float(row["wall_high_s"])
        assert 0.0 < float(row["further_s"]) < float(row["wall_s"])
        assert row["repeats"] == "2"
    # both are of second order: half the ITS leaves a quarter of the error, or nearly
    for far, near in zip(rows[::2], rows[1::2], strict=True):
        assert float(near["rebound_ratio_error"]) < 0.4 * float(far["rebound_ratio_error"])
    assert "gone" in said
    assert "not here" in said
    assert "no result" in said
    html = (tmp_path / "report.html").read_text()
    assert "Time at equal error" in html
    assert "not here" in html
    assert len(json.loads((tmp_path / "peers.json").read_text())["runs"]) == 12


def test_peers_are_refused_under_mpirun(tmp_path):
    done = mpirun(2, "-m", "bristle.studies.cli", "bench", "--out", tmp_path)
    assert done.returncode == 2
    assert "without mpirun" in done.stderr
    assert not list(tmp_path.iterdir())


def told(folder, name: str) -> list[dict[str, str]]:
    with (folder / "tables" / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_steps_page_tells_readings_and_solves(tmp_path):
    said = step.page(steps(), tmp_path, 3, [])
    html = (tmp_path / "report.html").read_text()
    sentence = "a solve takes 9 ms or 2.2 readings of its factor (goal 2), a step 1.11 solves, 1.33"
    assert sentence in html
    assert sentence in said
    assert f"bristle bench step --repeats 3 --out {tmp_path}" in html
    assert [float(row["solve_ms"]) for row in told(tmp_path, "step")] == [9.0, 18.0]
    assert len(json.loads((tmp_path / "step.json").read_text())["step"]) == 2


def test_the_page_of_sizes_tells_exponents_and_what_failed(tmp_path):
    lines = growing()
    said = sizes.page(lines, ["compact: no memory"], tmp_path, 200_000, [])
    html = (tmp_path / "report.html").read_text()
    assert "Along, direct: a step grows with the unknowns to the power 1.00" in html
    assert "Compact, direct: a step grows with the unknowns to the power 1.33" in html
    assert "Not done: compact: no memory." in html
    assert "Not done: compact: no memory." in said
    assert len(told(tmp_path, "sizes")) == len(lines)


def test_the_page_of_ranks_holds_efficiency_against_goal_and_memory(tmp_path):
    lines, machine, memory = shared_out()
    ranks.page(lines, machine, memory, tmp_path, 3, [])
    html = (tmp_path / "report.html").read_text()
    sentence = "One large solid on 2 ranks: efficiency 90 % of the march, 90 % of the whole"
    assert f"{sentence} (asked for 85 %, memory allows 90 %)." in html
    assert [row["memory_allows"] for row in told(tmp_path, "ranks")].count("0.9") == 3
    assert len(told(tmp_path, "predicted")) == 3


def test_a_table_stands_in_columns():
    """Each word ends, the first begins, where its column does."""
    head, unit, *rows = Part("step", "A step", steps()).lines()[1:-1]
    ends = [match.end() for match in re.finditer(r"\S+", rows[-1])][3:]
    for row in rows:
        assert [match.end() for match in re.finditer(r"\S+", row)][3:] == ends
    assert head.index("Cells") == 2
    assert unit.split()[:2] == ["GB/s", "GB/s"]


def test_sizes_that_are_all_too_large_are_refused(tmp_path):
    with pytest.raises(InputError, match="--largest"):
        sizes.run_sizes(tmp_path / "none", largest=10)
    assert not (tmp_path / "none").exists()
