"""The reproduction runs end to end, and its page says what its tables hold."""

from __future__ import annotations

import csv
import re

import numpy as np
import pytest
from mpi4py import MPI
from small_reproduction import reproduced, small

from bristle.solver import paper
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.sources import command_line
from bristle.studies.reproduce.campaign import Setup, compute
from bristle.studies.reproduce.discretisation import fewest
from bristle.studies.reproduce.impact import departs_at, window
from bristle.studies.reproduce.rebound import track
from bristle.studies.reproduce.run import paper_studies
from bristle.studies.running.cases import CaseSession


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    return reproduced(tmp_path_factory)[1]


@pytest.fixture(scope="module")
def page(done) -> str:
    return done.report.read_text()


def rows_of(done, name: str) -> list[dict[str, str]]:
    with (done.report.parent / "tables" / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


def test_every_section_is_on_the_page_and_none_is_empty(done, page):
    assert [type(study) for study in small()[1]] == [
        type(study) for study in paper_studies(Setup(DropInputs()))
    ]
    assert len(done.sections) == 15 + 1
    assert done.sections[-1].ident == "warnings"
    (table,) = done.sections[-1].tables
    assert any("degrees against the surface's normal" in row[-1] for row in table.rows)
    for section in done.sections:
        assert f'<section id="{section.ident}"' in page
        assert section.text
        assert section.tables or section.figures
    for name in (
        "fig9",
        "fig10to12",
        "fig13",
        "kn-from-ratio",
        "elements",
        "eq8",
        "leaning",
        "sticking",
    ):
        assert (done.report.parent / "figures" / f"{name}.svg").stat().st_size > 1000
        assert (done.report.parent / "figures" / f"{name}.png").stat().st_size > 1000


def test_numbers_on_the_page_are_those_of_the_tables(done, page):
    shown = set(re.findall(r'<data value="([^"]+)">', page))
    for name in ("crosscheck", "fig13_ratios", "enforcements", "eq8", "kn", "its_needed"):
        for row in rows_of(done, name):
            for value in row.values():
                if re.fullmatch(r"-?[\d.]+(e-?\d+)?", value):
                    assert value in shown, (name, value)


def test_the_page_says_where_paper_and_we_differ(done, page):
    assert "Where the paper and we differ" in page
    quantities = [c.quantity for s in done.sections for c in s.comparisons]
    assert len(quantities) == len(set(quantities)) >= 11
    assert "not measured" in page
    assert "0.0082" in page


def test_models_agree_within_the_target(done):
    for row in rows_of(done, "fig13_ratios"):
        assert abs(float(row["apart"])) < 2e-3
    for row in rows_of(done, "enforcements"):
        assert abs(float(row["rebound_ratio_apart"])) < 2e-3
    for row in rows_of(done, "crosscheck"):
        if row["energy_closure"]:
            assert float(row["energy_closure"]) < 1e-6


def test_eq_8_holds_for_soft_contact_and_not_for_stiff(done):
    first, *_, last = rows_of(done, "eq8")
    assert float(first["tp_rule_us"]) == pytest.approx(1e6 * paper.TIME_TO_PEAK_S[1e4], rel=2e-3)
    assert float(first["tp_ratio"]) == pytest.approx(1.0, abs=0.02)
    assert float(last["tp_rule_us"]) == pytest.approx(8.2, rel=2e-3)
    assert float(last["tp_ratio"]) < 0.5


@pytest.mark.serial
def test_the_cloud_follows_the_published_spread(done):
    rows = rows_of(done, "fig10to12")
    ratio = np.array([float(row["y1_mm"]) / float(row["y0_mm"]) for row in rows])
    assert ratio.mean() == pytest.approx(paper.RATIO_MEAN, abs=0.03)
    assert ratio.std() == pytest.approx(paper.RATIO_STD, abs=0.04)
    assert 0.31 < ratio.min() < ratio.max() <= 1.0


def test_each_case_is_computed_once_and_known_to_rank_0():
    setup = Setup(DropInputs(cells=(1, 1, 20)))
    cases = [setup.case(m, kn) for m in ("beam", "reduced") for kn in (1e6, 2e6)]
    ticks = []
    with CaseSession(MPI.COMM_WORLD, basis_its_s=setup.its_s) as session:
        results = compute([*cases, *cases], session, lambda: ticks.append(1))
    if MPI.COMM_WORLD.rank == 0:
        assert set(results) == set(cases)
        assert len(ticks) == len(cases)


def test_fewest_elements_must_stay_good():
    counts = (1, 2, 4, 8)
    assert fewest(counts, np.array([0.5, 0.001, 0.02, 0.001])) == 8
    assert fewest(counts, np.array([0.001, -0.002, 0.0, 0.0])) == 1
    assert fewest(counts, np.array([0.1, 0.1, 0.1, np.nan])) is None


def test_where_a_ratio_leaves_one():
    kn = np.array([1.0, 10.0, 100.0])
    assert departs_at(kn, np.array([1.0, 1.05, 1.15])) == pytest.approx(10.0**1.5)
    assert departs_at(kn, np.ones(3)) is None
    assert departs_at(kn, np.array([2.0, 1.0, 1.0])) == 1.0


@pytest.mark.serial
def test_windows_and_tracks_begin_and_end_with_what_they_show():
    setup = Setup(DropInputs())
    case = setup.case("beam", 2e6)
    with CaseSession(MPI.COMM_SELF) as session:
        result, _ = session.run(case)
    t, depth = window(result)
    assert t[0] == 0.0
    assert depth[0] == 0.0
    assert depth.max() == pytest.approx(result.max_penetration_m, rel=0.01)
    assert t[-1] <= result.contact_time_s * (1 + 1e-6)
    times, heights = track(result)
    assert heights[0] == pytest.approx(0.05)
    assert len(times) < 140
    assert heights.min() == result.history.array()[:, 1].min()


@pytest.mark.serial
def test_the_command_line_names_what_is_not_usual(tmp_path):
    inputs = DropInputs(cells=(1, 1, 60), its_s=2e-5)
    command = command_line("reproduce", inputs, DropInputs(), tmp_path)
    assert command.startswith("bristle reproduce ")
    assert "--cells 1 1 60" in command
    assert "--its 2e-05" in command
    assert "--kn" not in command
    assert command.endswith(f"--out {tmp_path}")
