"""A calibration finds the Kn that made the drops, with intervals that hold it."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hostile import drops_table, write_dataset
from scipy import stats
from solids import reduced_for

from bristle.solver import paper
from bristle.solver.bristle import Bristle, Material
from bristle.solver.contact.enforcement import ContactMethod
from bristle.solver.contact.laws import Linear
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.errors import ComputationError
from bristle.studies.calibrate.calibration import (
    RatioCurve,
    beam_model,
    calibrate,
    mean_curve,
    ratio_curve,
    stiffness_interval,
)
from bristle.studies.calibrate.estimate import (
    Interval,
    estimate_ratio,
    height_trend,
    paper_ratio,
    slope_interval,
)
from bristle.studies.calibrate.page import AREA, NODE, programs
from bristle.studies.calibrate.run import run_calibrate, summary, told
from bristle.studies.close_loop.run import problem_of
from bristle.studies.data.datasets import read_drops, read_manifest
from bristle.studies.inputs.study_fields import CalibrateInputs
from bristle.studies.loop.kinds.drops.problem import emulator_for
from bristle.studies.running.mark import MARK

pytestmark = [pytest.mark.serial, pytest.mark.usefixtures("no_pictures")]

GRID = np.concatenate([[1e3, 1e4], np.geomspace(1e5, 1e8, 19), [1e9, 1e10]])
KN = 3.1e6


@pytest.fixture(scope="module")
def model():
    return beam_model(Bristle(), paper.GRAVITY_M_S2)


@pytest.fixture(scope="module")
def curve(model) -> RatioCurve:
    return ratio_curve(model, 0.03, GRID)


@pytest.fixture
def folder(tmp_path):
    """A function that writes a dataset: its toml and its table."""

    def write(rows: str, toml: str = "", head: str = "drop,y0_mm,y1_mm"):
        about = '[dataset]\ntitle = "T"\nkind = "drops"\n' if "[dataset]" not in toml else ""
        (tmp_path / "dataset.toml").write_text(about + toml)
        (tmp_path / "drops.csv").write_text(f"{head}\n{rows}")
        return tmp_path

    return write


GOOD = "1,10,6.5\n2,20,13.1\n3,30,19.2\n4,40,26.3\n"


def falling_ratio(kn: float, height: float) -> float:
    """About the ratio of a beam."""
    return 0.31 + 0.69 / (1.0 + kn / 2e6)


def test_ratio_falls_with_stiffness_from_one_to_the_rigid_limit(curve):
    assert np.all(np.diff(curve.ratio) < 2e-4)
    low, high = curve.reachable
    assert high == pytest.approx(1.0, abs=1e-4)
    assert 0.30 < low < 0.32


def test_the_curve_between_its_points_is_the_model(curve, model):
    for kn in (3.3e5, 2e6, 1.7e7):
        assert float(curve.at(kn)) == pytest.approx(model(kn, 0.03), abs=1e-3)
        assert curve.stiffness(model(kn, 0.03)) == pytest.approx(kn, rel=1e-2)


def test_outside_the_reachable_ratios_kn_is_bounded_on_one_side_only(curve):
    low, high = curve.reachable
    assert curve.stiffness(high + 0.01) == 0.0
    assert curve.stiffness(low - 0.01) == math.inf
    above = stiffness_interval(curve, Interval(1.02, 0.95, 1.09))
    assert above.estimate is None
    assert above.low is None
    assert above.high == pytest.approx(curve.stiffness(0.95))
    assert "no lower bound" in above.words()
    below = stiffness_interval(curve, Interval(0.2, 0.1, 0.4))
    assert below.estimate is None
    assert below.high is None
    assert "no upper bound" in below.words()
    assert "not bounded" in stiffness_interval(curve, Interval(0.6, 0.2, 1.1)).words()


def test_a_body_whose_ratio_does_not_fall_is_refused():
    bare = beam_model(Bristle(material=Material(beta_s=1e-8)), paper.GRAVITY_M_S2)
    with pytest.raises(ComputationError, match="several Kn"):
        ratio_curve(bare, 0.05, np.geomspace(1e5, 1e9, 9))


def test_kn_is_recovered_from_drops_of_the_solid(make_solid, model, folder, rng):
    """The drops come from the reduced 3-D solid, the curve from the beam."""
    bristle = Bristle()
    solid = make_solid(cells=(1, 1, 40), length_m=bristle.length_m)
    its = 1e-6
    frame = ModalFrame(reduced_for(solid, its, 60).modal)
    y0 = rng.uniform(0.01, 0.05, 12)
    rows = ""
    for i, height in enumerate(y0):
        plan = DropPlan(height, ContactMethod(Linear(KN)), its, paper.GRAVITY_M_S2)
        y1 = simulate(frame, plan).rebound_height_m + rng.normal(0.0, 0.3e-3)
        rows += f"{i + 1},{1e3 * height:.6f},{1e3 * y1:.6f}\n"
    drops = read_drops(folder(rows, "[measurement]\nsigma_y_mm = 0.3\n"))
    found = calibrate(drops, model, grid_N_m=GRID, seed=1)
    assert found.kn.low < KN < found.kn.high
    assert found.kn.estimate == pytest.approx(KN, rel=0.05)
    assert found.ratio.trend.p_value > 0.01


@pytest.mark.parametrize("scatter", ["constant", "proportional"])
def test_the_90_percent_interval_holds_the_truth_nine_times_in_ten(curve, scatter):
    random = np.random.default_rng(7)
    truth, trials = float(curve.at(KN)), 1500
    hits = 0
    for _ in range(trials):
        y0 = random.uniform(0.01, 0.05, 15)
        spread = 2e-3 if scatter == "constant" else 0.15 * y0
        y1 = truth * y0 + spread * random.standard_normal(15)
        kn = stiffness_interval(curve, slope_interval(y0, y1))
        hits += (kn.low or 0.0) <= KN <= (kn.high or math.inf)
    low, high = stats.binom.interval(0.999, trials, 0.9)
    assert low <= hits <= high


def test_the_bootstrap_is_near_the_t_interval_and_repeats_with_its_seed(rng):
    y0 = rng.uniform(0.01, 0.05, 40)
    y1 = 0.6 * y0 * (1.0 + 0.2 * rng.standard_normal(40))
    one, again = (estimate_ratio(y0, y1, seed=5) for _ in range(2))
    assert one.bootstrap == again.bootstrap
    assert one.bootstrap.low == pytest.approx(one.mean.low, rel=0.05)
    assert one.bootstrap.high == pytest.approx(one.mean.high, rel=0.05)


def test_a_declared_sensor_keeps_the_interval_from_vanishing():
    y0 = np.array([0.01, 0.02, 0.03])
    exact = slope_interval(y0, 0.65 * y0)
    assert exact.high - exact.low < 1e-12
    known = slope_interval(y0, 0.65 * y0, sigma_m=1e-3)
    assert known.high - known.low > 0.05


def test_columns_that_were_exchanged_are_doubted(tmp_path):
    table = drops_table().splitlines()
    rows = [row.split(",") for row in table[1:]]
    rows = [[row[0], row[2], row[1], *row[3:]] for row in rows]
    text = "\n".join([table[0], *map(",".join, rows)]) + "\n"
    drops = read_drops(write_dataset(tmp_path / "data", "drops", table=text))
    first, second = calibrate(drops, grid_N_m=np.array([1e4, 1e6, 1e8])).warnings[:2]
    assert f"y1_mm exceeds y0_mm in {len(rows)} of {len(rows)} drops" in first
    assert "none explains them" in second
    assert read_drops(write_dataset(tmp_path / "meant", "drops")).doubt == ""


def test_a_trend_with_height_is_found_and_none_is_not(rng):
    y0 = rng.uniform(0.01, 0.05, 60)
    noise = 3e-4 * rng.standard_normal(60)
    assert height_trend(y0, (0.7 - 4.0 * y0) * y0 + noise).p_value < 1e-3
    assert height_trend(y0, 0.65 * y0 + noise).p_value > 0.01
    assert height_trend(np.full(6, 0.03), np.full(6, 0.02)) is None


def test_mean_curve_of_one_height_is_its_curve():
    asked = []

    def model(kn: float, height: float) -> float:
        asked.append(height)
        return 1.0 / (1.0 + kn / 1e6) + 0.001 * height

    one = mean_curve(model, np.array([0.02, 0.02]), GRID)
    assert set(asked) == {0.02}
    two = mean_curve(model, np.array([0.01, 0.05]), GRID)
    weights = np.array([0.01, 0.05]) ** 2
    mean_height = weights @ np.array([0.01, 0.05]) / weights.sum()
    assert two.ratio - one.ratio == pytest.approx(0.001 * (mean_height - 0.02))


def test_the_paper_gives_about_2_MN_m_and_says_what_cannot_be_told(model, tmp_path):
    found = calibrate(None, model, grid_N_m=GRID)
    assert paper_ratio().mean.estimate == 0.65
    assert found.kn.estimate == pytest.approx(2.05e6, rel=0.02)
    assert found.population.low is None
    assert found.population.high is None
    assert any("cannot tell them apart" in each for each in found.warnings)


def test_the_stiffness_is_told_in_other_programs_terms(model):
    """Springs all over the face, or one at a node of the axis, push alike where all sinks alike."""
    found = calibrate(None, model, grid_N_m=GRID)
    kn, depth_m = found.kn.estimate, 1e-6
    options = programs(kn, found.bristle.section.area_m2)
    force_N = {AREA: paper.WIDTH_M * paper.THICKNESS_M * depth_m, NODE: depth_m}
    for program, _, what, si, mm in options.itertuples(index=False):
        assert si * force_N[what] == pytest.approx(kn * depth_m), program
        in_mm = {AREA: 1e6 * 1e3, NODE: 1e3}[what]  # areas, depths
        assert mm * force_N[what] * in_mm == pytest.approx(kn * depth_m), program
    said = dict(told(summary(found, "0")))
    assert said["Kn over the end face"] == "1.97e+12 N/m³ = 1.97e+03 N/mm³"
    assert said["Kn at one node"] == "2.05e+06 N/m = 2.05e+03 N/mm"


def test_command_writes_json_and_page_of_a_dataset(folder, tmp_path):
    where = folder(GOOD)
    out = tmp_path / "out"
    content = run_calibrate(where, out, CalibrateInputs(seed=3), model=falling_ratio)
    assert json.loads((out / "calibrate.json").read_text()) == content
    assert content["kn_N_m"]["low"] < content["kn_N_m"]["estimate"] < content["kn_N_m"]["high"]
    assert {path.name for path in out.iterdir()} == {
        "calibrate.json", "report.html", "tables", "figures", MARK,
    }  # fmt: skip
    doubts = [text for name, text in told(content) if name == "doubt"]
    assert doubts == content["warnings"] != []


def test_what_a_dataset_leaves_out_is_the_paper_s(folder):
    manifest = read_manifest(folder(GOOD, "[body]\nlength_m = 0.2\n[contact]\nkn_N_m = 1e6\n"))
    assert manifest.bristle.length_m == 0.2
    assert manifest.bristle.material == Material()
    assert manifest.declared == ("length_m",)
    assert manifest.lengths_left_out == ["width_m", "thickness_m"]
    # of the usual length, whose tables other tests have made
    usual = read_manifest(folder(GOOD, f"[body]\nlength_m = {paper.LENGTH_M}\n"))
    *_, doubt = problem_of(usual).warnings
    assert doubt.startswith("[body] does not give width_m and thickness_m")
    strange = read_manifest(folder(GOOD, "[measurement]\nnonsense = 3\n"))
    *_, doubt = problem_of(strange).warnings
    assert doubt == "nothing reads these of [measurement]: nonsense"
    assert manifest.kn_N_m == 1e6
    assert manifest.gravity_m_s2 == paper.GRAVITY_M_S2
    assert manifest.friction is None


def test_friction_that_is_declared_is_what_drops_are_simulated_with(folder):
    drops = read_drops(folder(GOOD, "[contact]\nfriction = 0.0\n"))
    assert emulator_for(drops.y0_m, drops.manifest).friction == 0.0


def test_optional_columns_and_units(folder):
    where = folder(
        "1,10,6,0.16,\n2,20,12,,41\n3,30,18,0.17,42\n",
        head="drop,y0_mm,y1_mm,contact_time_ms,peak_force_N",
    )
    drops = read_drops(where)
    assert drops.y0_m == pytest.approx([0.01, 0.02, 0.03])
    assert drops.contact_time_s[[0, 2]] == pytest.approx([1.6e-4, 1.7e-4])
    assert math.isnan(drops.contact_time_s[1])
    assert math.isnan(drops.peak_force_N[0])
    assert drops.session is None


def test_a_damping_that_nobody_declared_is_doubted(folder):
    """Kn of one ratio is another with another damping, so a guessed one must not pass for known."""
    grid = np.array([1e4, 1e6, 1e8])

    def doubts(toml: str) -> list[str]:
        found = calibrate(read_drops(folder(GOOD, toml)), falling_ratio, grid_N_m=grid)
        return [each for each in found.warnings if each.startswith("[body] does not give")]

    lengths = f"[body]\nlength_m = {paper.LENGTH_M}\ndiameter_m = 1e-3\n"
    (doubt,) = doubts(lengths)
    assert f"damping_beta_s; the {paper.BETA_S:.3g} s of the paper's" in doubt
    assert doubts(f"{lengths}damping_beta_s = 1e-6\n") == []
    assert doubts("") == []
    of_lengths, of_damping = doubts("[body]\nlength_m = 0.2\n")
    assert of_lengths.startswith("[body] does not give width_m and thickness_m")
    assert of_damping == doubt


def test_a_table_with_contact_times_is_not_asked_for_them(folder):
    grid = np.array([1e4, 1e6, 1e8])

    def last(rows: str, head: str) -> str:
        found = calibrate(read_drops(folder(rows, head=head)), falling_ratio, grid_N_m=grid)
        return found.warnings[-1]

    assert "Measure contact time or force" in last(GOOD, "drop,y0_mm,y1_mm")
    timed = GOOD.replace("\n", ",0.16\n")
    assert "Measure" not in last(timed, "drop,y0_mm,y1_mm,contact_time_ms")
    assert "close-loop" in last(timed, "drop,y0_mm,y1_mm,contact_time_ms")


def test_drops_that_bounce_to_their_own_height_say_so(model, folder):
    drops = read_drops(folder("1,10,10.2\n2,20,20.1\n3,30,30.2\n4,40,40.3\n"))
    found = calibrate(drops, model, grid_N_m=GRID)
    assert found.kn.estimate is None
    assert found.kn.low is None
    assert any("none explains them" in each for each in found.warnings)
    near = read_drops(folder("1,10,10.3\n2,20,19.2\n3,30,30.9\n4,40,40.2\n"))
    assert any("from above only" in each for each in calibrate(near, model, grid_N_m=GRID).warnings)
