"""Studies compute what the solver says, leave whole files, and lose nothing on failure."""

import csv
import json
import math
import os
import re
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import mpirun, python
from mpi4py import MPI

from bristle.solver.analytic import quarter_period_s
from bristle.solver.bodies.reduced import krylov_vectors
from bristle.solver.errors import ComputationError, InputError
from bristle.studies import __version__, its
from bristle.studies import drop as drop_study
from bristle.studies import sweep as sweep_study
from bristle.studies.cli import main
from bristle.studies.drop import run_drop
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.limits import closure_warnings, count_unknowns, result_warnings
from bristle.studies.inputs.sources import checked
from bristle.studies.its import ItsInputs, Need, limit, need, run_its
from bristle.studies.running import cases, results
from bristle.studies.running.cases import CaseSession, run_case
from bristle.studies.running.files import to_csv, to_json, write_atomically
from bristle.studies.running.mark import MARK
from bristle.studies.running.parallel import share_out
from bristle.studies.running.study import COLUMNS, StudyInputs
from bristle.studies.sweep import SweepInputs, run_sweep

COMM = MPI.COMM_WORLD
SMALL = {"cells": (1, 1, 20)}
CONTRACT_KEYS = (
    "schema version inputs model contact impact_speed_m_s rebound_ratio rebound_height_m "
    "contact_time_s n_contacts peak_force_N impulse_N_s max_penetration_m "
    "time_to_max_penetration_s cm_velocity_after_m_s n_dofs n_steps energy wall_s peak_rss_MB "
    "ranks "
    "cm_rebound_height_m cm_rebound_ratio velocity_after_m_s spin_after_rad_s friction_impulse_N_s"
)
ENERGY_KEYS = (
    "initial_J kinetic_J strain_J potential_J contact_J material_loss_J contact_loss_J "
    "friction_loss_J drag_loss_J numerical_J closure_relative"
)
TABLE_KEYS = (
    "model contact kn_N_m y0_m its_s rebound_ratio contact_time_s peak_force_N max_penetration_m "
    "energy_closure wall_s"
)
serial = pytest.mark.serial
pytestmark = pytest.mark.usefixtures("no_pictures")


def drop(**values):
    return checked(DropInputs, {**SMALL, **values})


def sweep(**values):
    return checked(StudyInputs, {**SMALL, "kn_N_m": "1e5,2e6", "heights_m": "0.01", **values})


def read_table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def contents(folder):
    files = (path for path in folder.iterdir() if path.is_file() and path.name != MARK)
    return {path.name: path.read_bytes() for path in files}


@pytest.fixture
def out(tmp_path):
    """One folder for all ranks."""
    return Path(COMM.bcast(str(tmp_path))) / "out"


# cases


def test_reduced_and_solid_agree_and_the_wire_too():
    for section in ({}, {"diameter_m": 1e-3}):
        reduced, _ = run_case(drop(model="reduced", **section), COMM)
        solid, _ = run_case(drop(model="solid", **section), COMM)
        assert solid.n_dofs > reduced.n_dofs
        assert solid.rebound_ratio == pytest.approx(reduced.rebound_ratio, rel=1e-6)
        assert solid.peak_force_N == pytest.approx(reduced.peak_force_N, rel=1e-6)


@serial
def test_a_basis_that_would_fill_too_much_memory_is_not_doubled(monkeypatch):
    inputs = drop(model="reduced", modes=4, reduction_tolerance=1e-9, its_s=1e-6, beta_s=1e-8)
    grown, _ = run_case(inputs, COMM)
    vectors = krylov_vectors(8, leaning=False) * count_unknowns(inputs)
    monkeypatch.setattr(cases, "MOST_NUMBERS", vectors)
    once, _ = run_case(inputs, COMM)
    monkeypatch.setattr(cases, "MOST_NUMBERS", vectors - 1)
    never, _ = run_case(inputs, COMM)
    assert never.n_dofs < once.n_dofs < grown.n_dofs
    assert any("raise --modes" in each for each in result_warnings(inputs, never))


@serial
@pytest.mark.parametrize("model", ["beam", "analytic"])
def test_what_a_drop_ends_before_is_not_reported(model):
    """In contact, on the way up, and past the top, before the second impact."""

    def run(inputs):
        return run_case(inputs)[0]

    values = {"height_m": 1e-3, "elements": 4, "model": model}
    whole = run(drop(**values))
    fall_s = math.sqrt(2.0 * 1e-3 / 9.8)
    release_s = fall_s + whole.contact_time_s
    rise_s = whole.cm_velocity_after_m_s / 9.8
    for end_s in (fall_s + 0.5 * whole.contact_time_s, release_s + 0.5 * rise_s):
        inputs = drop(**values, until=end_s)
        result = run(inputs)
        shown = {name: results.number(name, inputs, result) for name in results.NUMBERS}
        assert shown["rebound_ratio"] is None
        assert shown["rebound_height_m"] is None
        assert shown["cm_rebound_ratio"] is None
        in_contact = end_s < release_s
        for name in ("contact_time_s", "cm_velocity_after_m_s", "velocity_after_m_s"):
            assert (shown[name] is None) == in_contact
        assert shown["peak_force_N"] > 0.0
        warnings = [text for text in result_warnings(inputs, result) if "no rebound" in text]
        (warning,) = warnings
        assert warning.startswith("no rebound was seen: the drop ends at ")
        assert ("within the first impact" in warning) == in_contact
    seen = run(drop(**values, until=release_s + 1.6 * rise_s))
    assert seen.rebound_ratio == pytest.approx(whole.rebound_ratio, rel=1e-9)
    assert seen.cm_rebound_height_m == pytest.approx(whole.cm_rebound_height_m, rel=1e-9)


@serial
def test_the_analytic_model_can_stop_after_the_impact():
    result, _ = run_case(drop(model="analytic", until="impact"))
    rows = result.history.array()
    fall_s = math.sqrt(2.0 * 0.05 / 9.8)
    assert rows[-1, 0] == pytest.approx(fall_s + result.contact_time_s, rel=1e-9)
    assert (result.rebound_ratio, result.rebound_height_m) == (None, None)


@serial
@pytest.mark.parametrize("effects", [[], ["air_drag:cd=2"]])
@pytest.mark.parametrize("part", [0.3, 1.4])
def test_the_analytic_model_can_stop_in_the_impact(part, effects):
    """In quarters of a period: before the greatest penetration, and after it."""
    whole, _ = run_case(drop(model="analytic", effects=effects))
    rows = whole.history.array()
    quarter_s = whole.time_to_max_penetration_s
    touch_s = rows[np.flatnonzero(rows[:, 3] > 0.0)[0] - 1, 0]
    end_s = float(touch_s + part * quarter_s)
    result, _ = run_case(drop(model="analytic", effects=effects, until=end_s))
    rows = result.history.array()
    assert rows[-1, 0] == end_s
    assert (np.diff(rows[:, 0]) > 0.0).all()
    # what the history adds up to: a sample is 1/400 of the impact, or pi/400 of the angle
    assert result.peak_force_N == pytest.approx(rows[:, 3].max(), rel=1e-4)
    assert result.max_penetration_m == pytest.approx(rows[:, 4].max(), rel=1e-4)
    assert result.impulse_N_s == pytest.approx(np.trapezoid(rows[:, 3], rows[:, 0]), rel=1e-4)
    assert result.time_to_max_penetration_s == pytest.approx(min(part, 1.0) * quarter_s, rel=1e-9)
    assert math.isnan(result.contact_time_s)
    # the momentum that is left is that of the kinetic energy
    mass, speed = drop().bristle().mass_kg, whole.impact_speed_m_s
    left = mass * speed - result.impulse_N_s
    assert result.energy.kinetic_J == pytest.approx(0.5 * left**2 / mass, rel=1e-9)
    assert result.energy.contact_J == pytest.approx(0.5 * 2e6 * rows[-1, 4] ** 2, rel=1e-9)


# leaning


def test_reduced_and_solid_agree_where_they_lean_and_the_beam_nearly():
    for values in ({"tilt_deg": 2.0}, {"tilt_wide_deg": 2.0, "slope_deg": -1.0}):
        values["deflection"] = "small"  # the solid is linear
        found = [run_case(drop(model=m, **values), COMM)[0] for m in ("reduced", "solid", "beam")]
        reduced, solid, beam = found
        assert reduced.cm_velocity_after_m_s == pytest.approx(solid.cm_velocity_after_m_s, rel=1e-6)
        assert reduced.velocity_after_m_s == pytest.approx(solid.velocity_after_m_s, abs=1e-6)
        assert beam.cm_velocity_after_m_s == pytest.approx(solid.cm_velocity_after_m_s, rel=0.02)
        for result in found:
            assert result.energy.friction_loss_J > 0.0
        for result in (reduced, beam):
            assert result.energy.closure_relative < 1e-9
        # the solid's march conserves too; what its flight leaves out is named apart
        budget = solid.energy
        assert abs(budget.numerical_J - budget.flight_J) < 1e-9 * budget.initial_J
        assert budget.flight_J < 2e-6 * budget.initial_J  # as the velocities agree


@serial
@pytest.mark.parametrize("side", ["", "_wide"])
def test_a_lean_to_the_other_side_is_the_mirror_image(side):
    axis = 1 if side else 0
    there, back = (run_case(drop(**{f"tilt{side}_deg": tilt}))[0] for tilt in (3.0, -3.0))
    assert back.n_contacts == there.n_contacts
    assert back.cm_rebound_height_m == pytest.approx(there.cm_rebound_height_m, rel=1e-7)
    assert back.friction_impulse_N_s == pytest.approx(there.friction_impulse_N_s, rel=1e-6)
    assert abs(there.velocity_after_m_s[axis]) > 1e-3
    assert back.velocity_after_m_s[axis] == pytest.approx(-there.velocity_after_m_s[axis], rel=1e-6)
    assert back.spin_after_rad_s[1 - axis] == pytest.approx(
        -there.spin_after_rad_s[1 - axis], rel=1e-6
    )
    assert abs(there.velocity_after_m_s[1 - axis]) < 1e-6


@serial
def test_a_tip_worn_to_its_lean_lands_flat():
    flat, _ = run_case(drop(friction=0.0))
    worn, _ = run_case(drop(friction=0.0, tilt_deg=2.0, tip_shape="worn:angle=2"))
    edge, _ = run_case(drop(friction=0.0, tilt_deg=-2.0, tip_shape="worn:angle=2"))
    upright, _ = run_case(drop(friction=0.0, tilt_deg=4.0))
    assert worn.max_penetration_m == pytest.approx(flat.max_penetration_m, rel=0.1)
    assert edge.max_penetration_m == pytest.approx(upright.max_penetration_m, rel=0.1)


def test_a_shaped_tip_is_the_same_for_solid_and_reduced():
    lean = {"tilt_deg": 2.0, "deflection": "small"}  # the solid is linear
    shape = {**lean, "tip_shape": "chamfer:width=1e-4,angle=30"}
    with CaseSession(COMM) as session:
        flat, _ = session.run(drop(model="solid", **lean))
        solid, _ = session.run(drop(model="solid", **shape))
        reduced, _ = session.run(drop(model="reduced", **shape))
        again, _ = session.run(drop(model="solid", **lean))
    assert solid.peak_force_N == pytest.approx(reduced.peak_force_N, rel=1e-6)
    assert abs(solid.peak_force_N / flat.peak_force_N - 1.0) > 1e-3
    assert again.peak_force_N == pytest.approx(flat.peak_force_N, rel=1e-12)


def test_a_session_tells_bodies_leans_frictions_and_faces_apart():
    """What it keeps of one drop changes no other. A solid's marches share a factor."""
    solid = {"model": "solid"}
    changes = (
        {},
        solid,
        {**solid, "kn_N_m": 1e7},
        {**solid, "height_m": 0.01},
        {"kn_N_m": 1e7},
        {"height_m": 0.01},
        {"model": "beam"},
        {"model": "beam", "elements": 2},
        {"beta_s": 0.0},
        {"length_m": 0.1},
        {"gravity_m_s2": 5.0},
        {"tilt_deg": 2.0},
        {"tilt_deg": 2.0, "friction": 0.0},
        {"tilt_deg": 2.0, "kt_ratio": 0.2},
        {"tilt_deg": 2.0, "contact_points": 5},
        {"tilt_deg": 2.0, "tip_shape": "rounded:radius=1e-4"},
        {"slope_deg": -2.0},
        {"tilt_wide_deg": 2.0},
        {},
    )
    seen = []
    with CaseSession(COMM) as session:
        for change in changes:
            shared, again = session.run(drop(**change))
            alone, timings = run_case(drop(**change), COMM)
            close = 1e-9 if solid.items() <= change.items() else 0.0
            for name in ("peak_force_N", "rebound_ratio", "velocity_after_m_s"):
                wanted = pytest.approx(getattr(alone, name), rel=close, abs=close)
                assert getattr(shared, name) == wanted
            # a reduced solid is kept from run to run, the solid itself is not
            assert timings["mesh"] > 0.0 or "model" not in change or change["model"] == "beam"
            assert timings["total"] == pytest.approx(sum(timings.values()) - timings["total"])
            seen.append(shared.velocity_after_m_s)
    assert len(set(seen)) == len(changes) - 1
    assert again["mesh"] == again["assemble"] == 0.0


@serial
def test_a_bristle_that_turns_fast_is_warned_of():
    inputs = drop(model="beam", tilt_deg=2.0, deflection="small")
    result, _ = run_case(inputs)
    assert result_warnings(inputs, result) == []
    fast = replace(result, spin_after_rad_s=(0.0, 0.0, 150.0))
    (warning,) = result_warnings(inputs, fast)
    assert "turns at 150 rad/s, above 14.7" in warning
    over = replace(result, spin_after_rad_s=(0.0, 12.0, 0.0))
    (warning,) = result_warnings(inputs, over)
    assert re.search(r"turns by about 1\d\d degrees before it comes down", warning)
    shallow = replace(result, max_penetration_m=5e-6)
    (warning,) = result_warnings(drop(model="beam", tilt_deg=20.0), shallow)
    remedy = int(re.search(r"take --contact-points (\d+)", warning).group(1))
    assert result_warnings(drop(model="beam", tilt_deg=20.0, contact_points=remedy), shallow) == []


@serial
def test_budgets_that_close_badly_are_warned_of():
    level, leaning = drop(model="beam"), drop(model="beam", tilt_deg=2.0)
    assert closure_warnings(level, [9e-7]) == closure_warnings(leaning, [9e-3]) == []
    (warning,) = closure_warnings(level, [1e-5])
    assert "budget closes to 1e-05" in warning
    assert "shorten --its" in warning
    (warning,) = closure_warnings(leaning, [1e-3, 0.05, 0.02])
    assert "budget of 2 of 3 drops closes to 0.05" in warning


@serial
def test_a_drop_that_makes_energy_out_of_nothing_is_refused():
    """A thin polymer bristle that falls from 0.6 m folds up, which second order does not know."""
    wire = {"diameter_m": 4e-4, "length_m": 0.25, "youngs_Pa": 9e9, "kn_N_m": 6e7, "beta_s": 4e-6}
    fall = {"height_m": 0.65, "tilt_deg": 4.5, "friction": 0.05, "its_s": 1e-6, "until": "impact"}
    with pytest.raises(ComputationError, match="the motion went astray: an impact at .* left"):
        run_case(checked(DropInputs, {"model": "beam", **wire, **fall}), MPI.COMM_SELF)


@serial
def test_a_patch_that_one_cell_covers_is_warned_of():
    """20 µm deep at 5 degrees: 20 µm / tan 5° = 229 µm from the edge, of 500 µm in one cell."""
    result, _ = run_case(drop(model="beam"))
    deep = replace(result, max_penetration_m=20e-6)
    leaning = {"model": "reduced", "tilt_deg": 5.0}
    (warning,) = result_warnings(drop(**leaning), deep)
    assert "over about 229 µm, less than the 500 µm of one cell" in warning
    remedy = tuple(map(int, re.search(r"--cells (\d+) (\d+) (\d+)", warning).groups()))
    assert remedy == (3, *SMALL["cells"][1:])
    assert result_warnings(checked(DropInputs, {**leaning, "cells": remedy}), deep) == []
    assert result_warnings(drop(model="beam", tilt_deg=5.0), deep) == []


# results


def test_result_has_the_contracts_keys(out):
    document = run_drop(drop(), out, COMM)
    COMM.Barrier()
    written = json.loads((out / "result.json").read_text())
    assert written == json.loads(to_json(document))
    promised = set(CONTRACT_KEYS.split())
    assert promised <= set(written)
    assert set(written) - promised == {"warnings", "reduction_error", "deflection", "mark"}
    assert list(written["energy"]) == [*ENERGY_KEYS.split(), "flight_J"]
    assert list(written["wall_s"]) == ["mesh", "assemble", "factor", "march", "total"]
    assert isinstance(written["schema"], int)
    assert written["ranks"] == COMM.size
    assert written["peak_rss_MB"] > 20.0 * COMM.size
    assert set(written["inputs"]) == set(DropInputs.model_fields)
    head = (out / "history.csv").read_text().splitlines()[0]
    assert head == "t_s,tip_y_m,cm_y_m,force_N,penetration_m"


def test_history_and_numbers_tell_one_story(out):
    document = run_drop(drop(), out, COMM)
    COMM.Barrier()
    rows = np.array([[float(x) for x in row.values()] for row in read_table(out / "history.csv")])
    assert (np.diff(rows[:, 0]) >= 0.0).all()
    assert rows[0, 1] == pytest.approx(0.05)
    assert rows[:, 3].max() == pytest.approx(document["peak_force_N"])
    after = rows[np.argmax(rows[:, 3]) :, 1]
    assert after.max() == pytest.approx(document["rebound_height_m"], rel=1e-3)
    assert document["rebound_height_m"] == pytest.approx(0.05 * document["rebound_ratio"])


@serial
def test_a_rigid_plane_is_written_without_infinity(out):
    run_drop(drop(kn_N_m="inf", contact="augmented", until="impact"), out)

    def refuse(token):
        raise AssertionError(token)

    written = json.loads((out / "result.json").read_text(), parse_constant=refuse)
    assert written["inputs"]["kn_N_m"] == "inf"
    assert written["rebound_ratio"] is None


@serial
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_disk_that_fails_leaves_the_old_file_and_no_other(tmp_path, monkeypatch, call):
    path = tmp_path / "result.json"
    write_atomically(path, "old")

    def fail(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(*((os, "fsync") if call == "fsync" else (Path, "replace")), fail)
    with pytest.raises(ComputationError, match="No space"):
        write_atomically(path, "new")
    assert contents(tmp_path) == {"result.json": b"old"}


def test_fields_of_a_solid_come_with_its_result_and_go_with_it(out, monkeypatch):
    """A run that fails leaves both as they were."""
    solid = drop(model="solid", its_s=2e-5)
    run_drop(solid, out, COMM)
    COMM.Barrier()
    frames, before = out / "fields" / "frames.csv", contents(out)
    seen = frames.read_text()
    assert len(seen.splitlines()) > 10

    def fail(*args, **kwargs):
        raise ComputationError("no")

    with monkeypatch.context() as patched:
        patched.setattr(CaseSession, "run", fail)
        with pytest.raises(ComputationError):
            run_drop(solid, out, COMM)
    COMM.Barrier()
    assert frames.read_text() == seen
    assert contents(out) == before
    run_drop(drop(), out, COMM)
    COMM.Barrier()
    assert sorted(path.name for path in out.iterdir()) == ["history.csv", "result.json", MARK]


@serial
def test_resume_keeps_a_finished_drop_and_names_a_difference(out, monkeypatch):
    document = run_drop(drop(), out)
    before = contents(out)
    monkeypatch.setattr(drop_study, "_compute", None)  # nothing may be computed again
    assert run_drop(drop(), out, resume=True)["rebound_ratio"] == document["rebound_ratio"]
    with pytest.raises(InputError, match=r"--kn is 2000000.0 there, 1000000.0 is asked"):
        run_drop(drop(kn_N_m=1e6), out, resume=True)
    monkeypatch.setattr(results, "__version__", "99")
    with pytest.raises(InputError, match=r"made by version .*, this is 99"):
        run_drop(drop(), out, resume=True)
    assert contents(out) == before


@serial
def test_resume_computes_what_is_not_there(out):
    assert run_drop(drop(), out, resume=True)["n_contacts"] == 1
    (out / "result.json").write_text("{")
    with pytest.raises(InputError, match="result.json:1: not valid JSON"):
        run_drop(drop(), out, resume=True)


@serial
def test_json_and_csv_hold_no_nan():
    assert json.loads(to_json({"a": [math.nan, math.inf, -math.inf, np.float64(1.0)]})) == {
        "a": [None, "inf", "-inf", 1.0]
    }
    assert to_csv(("a", "b", "c"), [(math.nan, None, 0.1)]) == "a,b,c\n,,0.1\n"


# sweep and ITS


def test_a_sweep_is_the_same_as_its_drops(out):
    run_sweep(sweep(models="analytic,beam,reduced,solid"), out, comm=COMM)
    COMM.Barrier()
    rows = read_table(out / "table.csv")
    assert list(rows[0]) == list(COLUMNS)
    assert list(COLUMNS[:11]) == TABLE_KEYS.split()
    order = [(row["model"], float(row["kn_N_m"])) for row in rows]
    models = ("analytic", "beam", "reduced", "solid")
    assert order == [(model, kn) for model in models for kn in (1e5, 2e6)]
    assert list(COLUMNS[-3:]) == ["cm_rebound_ratio", "friction_impulse_N_s", "friction_loss_J"]
    for row in rows:
        case = drop(model=row["model"], kn_N_m=float(row["kn_N_m"]), height_m=0.01)
        alone, _ = run_case(case, COMM)
        assert float(row["rebound_ratio"]) == pytest.approx(alone.rebound_ratio, rel=1e-9)
        assert float(row["peak_force_N"]) == pytest.approx(alone.peak_force_N, rel=1e-9)
    names = {path.name for path in out.iterdir()}
    assert names == {"table.csv", "sweep.json", "heights.svg", "heights.png", "cases.jsonl", MARK}


def alone_and_over_ranks(folder, ranks, **options):
    """Pairs of rows of a sweep's tables, by this process and by so many ranks, who speak once."""
    words = [f"--{name}={value}" for name, value in options.items()]
    words += ["--cells", "1", "1", "12", "--elements", "4", "--out"]
    assert main(["sweep", *words, str(folder / "one")]) == 0
    done = mpirun(ranks, "-m", "bristle.studies.sweep", *words, folder / "many")
    assert done.returncode == 0, done.stderr
    one, many = (read_table(folder / name / "table.csv") for name in ("one", "many"))
    assert done.stdout.count(f"{len(one)} cases in") == 1
    return list(zip(one, many, strict=True))


@serial
@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.campaign)])
def test_a_sweep_over_ranks_gives_the_serial_table(tmp_path, ranks):
    lists = {"models": "analytic,beam,reduced,solid", "kn": "1e5,2e6,1e7", "heights": "0.01,0.03"}
    pairs = alone_and_over_ranks(tmp_path, ranks, **lists)
    assert len(pairs) == 24
    own = {"wall_s", "energy_closure", "reduction_error", "friction_impulse_N_s"}
    for a, b in pairs:
        assert float(b["friction_impulse_N_s"]) < 1e-8  # upright: rounding
        for name in set(COLUMNS) - own:
            try:
                assert float(b[name]) == pytest.approx(float(a[name]), rel=1e-7)
            except ValueError:
                assert b[name] == a[name]


@serial
def test_a_leaning_sweep_over_ranks_gives_the_serial_table(tmp_path):
    lists = {"models": "beam,reduced", "kn": "1e5,2e6", "heights": "0.01", "tilt": "2"}
    pairs = alone_and_over_ranks(tmp_path, 2, **lists)
    assert len(pairs) == 4
    for a, b in pairs:
        assert float(b["friction_loss_J"]) > 0.0
        for name in ("rebound_ratio", "cm_rebound_ratio", "peak_force_N", "friction_loss_J"):
            assert float(b[name]) == pytest.approx(float(a[name]), rel=1e-6)


@serial
def test_an_interrupted_sweep_is_taken_up_where_it_stopped(out, monkeypatch):
    inputs = sweep(models="beam", kn_N_m="1e5,1e6,2e6")
    run, count = CaseSession.run, []

    def break_off(self, case, *args, **kwargs):
        count.append(case)
        if len(count) == 3:
            raise KeyboardInterrupt
        return run(self, case, *args, **kwargs)

    with monkeypatch.context() as patched:
        patched.setattr(CaseSession, "run", break_off)
        with pytest.raises(KeyboardInterrupt):
            run_sweep(inputs, out)
    assert not (out / "table.csv").exists()
    with (out / "cases.jsonl").open("a") as file:
        file.write('{"case": 2, "found": {"model": "be')  # torn

    def counted(self, case, *args, **kwargs):
        count.append(case)
        return run(self, case, *args, **kwargs)

    count.clear()
    monkeypatch.setattr(CaseSession, "run", counted)
    with pytest.raises(InputError, match="--friction is"):
        run_sweep(sweep(models="beam", kn_N_m="1e5,3e6", friction=0.1), out, resume=True)
    run_sweep(inputs, out, resume=True)
    assert [case.kn_N_m for case in count] == [2e6]
    assert [float(row["kn_N_m"]) for row in read_table(out / "table.csv")] == [1e5, 1e6, 2e6]
    before = contents(out)
    run_sweep(inputs, out, resume=True)
    assert len(count) == 1
    assert contents(out) == before
    # longer lists, and an input that is a list now, take up what is there
    count.clear()
    lists = {"models": "beam", "kn_N_m": "1e5,1e6,3e6", "heights_m": "0.01", "poisson": "0.28,0.3"}
    grown = checked(SweepInputs, {**SMALL, **lists})
    run_sweep(grown, out, resume=True)
    new = [(3e6, 0.28), (1e5, 0.3), (1e6, 0.3), (3e6, 0.3)]
    assert [(case.kn_N_m, case.poisson) for case in count] == new
    run_sweep(grown, out.with_name("anew"))
    again, anew = (read_table(folder / "table.csv") for folder in (out, out.with_name("anew")))
    assert [{**row, "wall_s": ""} for row in again] == [{**row, "wall_s": ""} for row in anew]
    # and what was left out for a while is still there
    count.clear()
    run_sweep(inputs, out, resume=True)
    assert count == []


@serial
def test_what_is_refused_or_fails_early_leaves_what_can_be_resumed(out, monkeypatch):
    run_sweep(sweep(models="beam"), out)
    before = contents(out)
    with pytest.raises(InputError, match="--ranks-per-case: there is 1 rank, not 2"):
        run_sweep(sweep(models="solid"), out, comm=MPI.COMM_SELF, ranks_per_case=2)
    assert contents(out) == before

    def fail(self, case, *args, **kwargs):
        raise ComputationError(f"no {case.kn_N_m:g}")

    # a start without a finished case does not take the place of one that has some
    monkeypatch.setattr(CaseSession, "run", fail)
    journal = before.pop("cases.jsonl")
    for _ in range(2):
        with pytest.raises(ComputationError, match="no 100000"):
            run_sweep(sweep(models="beam"), out)
        after = contents(out)
        assert after["cases.previous.jsonl"] == journal
        assert before.items() <= after.items()


def test_the_study_of_the_step_compares_with_the_converged_value(out):
    steps = "3e-5,1e-5,3e-6,1e-6,3e-7"
    inputs = checked(ItsInputs, {**SMALL, "models": "beam", "kn_N_m": "2e6,1e7", "its_s": steps})
    run_its(inputs, out, comm=COMM)
    COMM.Barrier()
    errors = [row for row in read_table(out / "errors.csv") if row["quantity"] == "peak_force_N"]
    needs = read_table(out / "needs.csv")
    assert {float(row["kn_N_m"]) for row in needs} == {2e6, 1e7}
    mass = inputs.bristle().mass_kg
    for row in needs:
        rule = quarter_period_s(mass, float(row["kn_N_m"]))
        assert float(row["rule_s"]) == pytest.approx(rule)
        assert float(row["paper_its_s"]) == 1e-5
    for kn in (2e6, 1e7):
        values = {float(r["its_s"]): r for r in errors if float(r["kn_N_m"]) == kn}
        finest = values[min(values)]
        error = float(finest["value"]) / float(finest["converged"]) - 1.0
        assert float(finest["error_relative"]) == pytest.approx(error)
        # a second-order scheme: between 1e-6 and 3e-7 s the error falls by about 11
        assert abs(float(finest["error_relative"])) < 2e-3
    of_force = [row for row in needs if "force" in row["quantity"]]
    force = {float(row["kn_N_m"]): float(row["its_needed_s"]) for row in of_force}
    assert force[1e7] < force[2e6]
    assert (out / "errors.svg").exists()
    assert (out / "needs.png").exists()


@serial
def test_a_step_that_fails_is_a_row_of_the_study_of_the_step(out, monkeypatch):
    longest, compute = 1e-4, CaseSession.run

    def run(session, inputs):
        if inputs.its_s == longest:
            raise ComputationError("the contact forces did not converge")
        return compute(session, inputs)

    monkeypatch.setattr(CaseSession, "run", run)
    values = {**SMALL, "models": "beam", "kn_N_m": "2e6"}
    run_its(checked(ItsInputs, {**values, "its_s": "1e-4,1e-5,1e-6,1e-7"}), out)
    first, *others = read_table(out / "table.csv")
    assert first["its_s"] == "0.0001"
    assert first["rebound_ratio"] == first["energy_closure"] == ""
    assert all(row["rebound_ratio"] for row in others)
    assert all(float(row["its_needed_s"]) < longest for row in read_table(out / "needs.csv"))
    assert "1 of 4 cases failed" in its.answer(out)[-1]
    with pytest.raises(ComputationError, match="no case could be computed"):
        run_its(checked(ItsInputs, {**values, "its_s": "1e-4"}), out / "none")


@serial
def test_a_basis_of_the_study_serves_every_step(out):
    values = {**SMALL, "models": "reduced", "kn_N_m": "2e6", "its_s": "1e-5,3e-6,1e-6"}
    run_its(checked(ItsInputs, values), out)
    for row in read_table(out / "table.csv"):
        own, _ = run_case(drop(model="reduced", its_s=float(row["its_s"])))
        assert float(row["rebound_ratio"]) == pytest.approx(own.rebound_ratio, rel=1e-6)


@serial
def test_a_sweep_answers_with_the_stiffness_of_the_papers_mean(tmp_path):
    """Half way between 0.8 and 0.5, by logarithms, lies 0.65."""
    rows = [(kn, y0, r) for y0 in (0.05, 0.01) for kn, r in ((4e6, 0.5), (1e6, 0.8), (9e6, None))]
    table = [("beam", "penalty", kn, y0, 1e-5, ratio) for kn, y0, ratio in rows]
    names = ("model", "contact", "kn_N_m", "y0_m", "its_s", "rebound_ratio")
    (tmp_path / "table.csv").write_text(to_csv(names, table))
    lines = sweep_study.answer(tmp_path)
    assert lines[2].split() == ["1e+06", "0.8000", "0.8000"]
    assert lines[4].split() == ["9e+06", "nan", "nan"]
    assert lines[-1].endswith("from 50 mm at Kn = 2e+06 N/m")
    (tmp_path / "table.csv").write_text(to_csv(names, table[1:2]))
    assert "mean" not in sweep_study.answer(tmp_path)[-1]


def test_the_study_of_the_step_answers_with_the_shortest_of_all_heights(tmp_path):
    names = ("model", "kn_N_m", "y0_m", "quantity", "its_needed_s", "bound")
    rows = [
        ("beam", 1e6, 0.01, "rebound_ratio", 1e-4, ">="),
        ("beam", 1e6, 0.05, "rebound_ratio", 3e-5, ""),
        ("beam", 1e6, 0.05, "peak_force_N", 1e-7, "<"),
    ]
    (tmp_path / "needs.csv").write_text(to_csv(names, rows))
    steps = [(f"{10.0**-k:g}", 1e-12) for k in (4, 5, 6)]
    (tmp_path / "table.csv").write_text(to_csv(("its_s", "energy_closure"), steps))
    assert its.answer(tmp_path)[-1].split() == ["beam", "1e+06", "3e-05", "<1e-07"]
    (tmp_path / "table.csv").write_text(to_csv(("its_s", "energy_closure"), steps[:1]))
    assert "of 1 steps alone" in its.answer(tmp_path)[-1]


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_extrapolation_is_exact_for_a_clean_order(order):
    h = np.array([1e-6, 1e-5, 3e-7, 3e-6])
    found = limit(h, 0.65 + 3.0 * (h / 1e-6) ** order * 1e-3)
    assert found.value == pytest.approx(0.65, rel=1e-12)
    assert found.order == pytest.approx(order, rel=1e-9)


@serial
@pytest.mark.parametrize("values", [[1.0, 1.1, 1.05], [1.0, 1.0, 1.0], [1.0, 1.1, 101.0]], ids=str)
def test_no_extrapolation_without_a_clean_order(values):
    found = limit(np.array([1e-7, 1e-6, 1e-5]), np.array(values))
    assert (found.value, found.order) == (1.0, None)


@serial
def test_the_needed_step_is_where_the_error_reaches_the_goal():
    h = np.geomspace(1e-7, 1e-4, 7)
    found = need(h, 0.04 * (h / 1e-5) ** 2, 0.01)
    assert found.its_s == pytest.approx(0.5e-5, rel=1e-9)
    assert found.bound == ""
    assert need(h, 0.0 * h, 0.01) == Need(pytest.approx(1e-4), ">=")
    assert need(h, 0.0 * h + 1.0, 0.01) == Need(pytest.approx(1e-7), "<")
    # a coarse step that is right by luck does not count
    lucky = np.where(h < 2e-6, 0.001, np.where(h < 5e-5, 0.1, 0.0))
    assert need(h, lucky, 0.01).its_s < 5e-6


# parallel


@pytest.mark.parametrize("count", [0, 1, 2, 5, 13])
def test_shared_work_arrives_once_each(count):
    taken = []
    share_out(COMM, count, lambda i: i * i, lambda i, result: taken.append((i, result)))
    expected = [(i, i * i) for i in range(count)] if COMM.rank == 0 else []
    assert sorted(taken) == expected


def test_a_failing_case_is_told_to_all_ranks_and_the_others_are_done():
    taken = []

    def work(i):
        if i in (4, 7):
            raise ComputationError(f"case {i}")
        return i

    with pytest.raises(ComputationError, match="case 4"):
        share_out(COMM, 9, work, lambda i, result: taken.append(i))
    if COMM.rank == 0:
        assert sorted(taken) == [0, 1, 2, 3, 5, 6, 8]


def test_whoever_is_free_works_and_results_are_taken_meanwhile():
    """Rank 0 waits in its first case until all others are done."""
    taken, mine = [], []

    def work(i):
        mine.append(i)
        until = time.monotonic() + 60.0
        while COMM.rank == 0 and COMM.size > 1 and len(taken) < 19 and time.monotonic() < until:
            time.sleep(0.01)

    share_out(COMM, 20, work, lambda i, result: taken.append(i))
    if COMM.rank == 0:
        assert sorted(taken) == list(range(20))
        assert len(mine) == (1 if COMM.size > 1 else 20)


@serial
def test_version_is_the_packages():
    project = Path(__file__).parents[2] / "pyproject.toml"
    assert tomllib.loads(project.read_text())["project"]["version"] == __version__


@serial
def test_memory_is_this_programs_own():
    code = (
        "from mpi4py import MPI; from bristle.studies.running.results import peak_rss_MB;"
        "a = peak_rss_MB(MPI.COMM_WORLD); x = b'x' * 200_000_000;"
        "print(peak_rss_MB(MPI.COMM_WORLD) - a)"
    )
    grown = python("-c", code)
    assert float(grown.stdout) == pytest.approx(200.0, rel=0.1)
