"""A scatter draws what it says, computes what single drops do, and says what the drops say."""

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from commands import mpirun
from mpi4py import MPI

from bristle.solver import paper
from bristle.solver.batch import Drops, drop_many
from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle
from bristle.solver.contact.enforcement import ContactMethod
from bristle.solver.contact.laws import Coulomb, Linear
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.errors import ComputationError, InputError
from bristle.solver.ground import Ground
from bristle.solver.rigid import leaning, matrix_of, slope_normal
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.fields import DROP_FLAGS, LIST_FLAGS
from bristle.studies.inputs.sources import checked, inputs_of
from bristle.studies.inputs.study_fields import SCATTER_FLAGS
from bristle.studies.running.cases import run_case
from bristle.studies.running.mark import claim
from bristle.studies.scatter import drops as scatter_drops
from bristle.studies.scatter.drops import draw, ground_of, ground_under
from bristle.studies.scatter.inputs import ScatterInputs
from bristle.studies.scatter.run import run_scatter
from bristle.studies.surface.ground import surface_facts, surface_of
from bristle.studies.surface.phases import Composite, Phase
from bristle.studies.surface.rough import Surface

pytestmark = pytest.mark.serial
STEEL = paper.YOUNGS_PA, paper.POISSON
TILT, TILT_WIDE, HEIGHT_M, MU = 1.5, -0.7, 0.03, 0.4
LEAN = {"tilt_deg": TILT, "tilt_wide_deg": TILT_WIDE}


def scatter(**values):
    return checked(ScatterInputs, {"model": "beam", "elements": 4, "contact_points": 5, **values})


def read(out):
    return json.loads((out / "scatter.json").read_text()), pd.read_csv(out / "drops.csv")


# the ground under the tip


@pytest.fixture(scope="module")
def marcher():
    body = beam_body(Bristle(), 4, points=5)
    method = ContactMethod(Linear(paper.KN_CHOSEN_N_M), friction=Coulomb(MU))
    return Marcher(body, method, TimeScheme.average(), paper.ITS_S, paper.GRAVITY_M_S2)


def places_over_ground(body, tilt, tilt_wide):
    return body.contact.places_m @ matrix_of(leaning(tilt, tilt_wide)).T


def one(body, **changes):
    spring = {"kn_N_m": paper.KN_CHOSEN_N_M, "mu": MU}
    drops = Drops.on_plane(len(body.contact.weights), height_m=HEIGHT_M, **spring, **LEAN)
    return replace(drops, **changes)


def alone(marcher, ground):
    how = (marcher.method, marcher.its_s, marcher.gravity_m_s2)
    plan = DropPlan(HEIGHT_M, *how, **LEAN, ground=ground)
    return simulate(ModalFrame(marcher.body), plan, marcher)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (2.0, 0.0), (-1.0, 3.0)])
def test_many_planes_of_one_slope_are_that_plane(marcher, slope):
    body, normal = marcher.body, slope_normal(*slope)
    n = len(body.contact.weights)
    over = places_over_ground(body, TILT, TILT_WIDE)[:, :2]
    # a plane's height where each point stands
    rises = -(over @ normal[:2]) / normal[2]
    found = drop_many(marcher, one(body, normals=np.tile(normal, (1, n, 1)), rises_m=rises[None]))
    expected = alone(marcher, Ground.plane(n, normal))
    for name in ("rebound_height_m", "cm_rebound_height_m", "peak_force_N", "contact_time_s"):
        assert getattr(found, name)[0] == pytest.approx(getattr(expected, name), rel=1e-9)
    # planes that are level where the points stand, though inclined, are another ground
    if slope != (0.0, 0.0):
        steps = drop_many(marcher, one(body, normals=np.tile(normal, (1, n, 1))))
        assert abs(steps.rebound_height_m[0] / expected.rebound_height_m - 1.0) > 1e-3


def test_where_all_of_the_ground_lies_does_not_matter(marcher):
    body = marcher.body
    rises = 1e-5 * np.random.default_rng(3).standard_normal((1, len(body.contact.weights)))
    low, high = (drop_many(marcher, one(body, rises_m=rises + up)) for up in (0.0, 0.25))
    assert high.rebound_height_m[0] == pytest.approx(low.rebound_height_m[0], rel=1e-9)
    level = drop_many(marcher, one(body))
    assert abs(level.rebound_height_m[0] / low.rebound_height_m[0] - 1.0) > 1e-3


def waves(size_m=0.04, n=80, height_m=2e-4):
    """A surface of two long waves of one material: its slope is known in closed form."""
    x = np.arange(n) / n * 2.0 * math.pi
    heights = height_m * (np.sin(x)[None, :] + 0.5 * np.cos(x)[:, None])
    one_phase = Composite((Phase("stone", 60e9, 0.2, 1.0),))
    return Surface(heights, size_m / n, np.zeros((n, n), dtype=np.uint8), one_phase)


def test_the_ground_is_the_surface_turned_into_the_bristles_axes(marcher):
    surface, points = waves(), marcher.body.contact
    released = draw(scatter(tilt_std_deg=2.0, seed=5), surface.size_m, 0, 20)
    under = ground_under(surface, points, released, STEEL)
    np.testing.assert_allclose(under.scale, 1.0, rtol=1e-12)
    x, y, turn = released.x_m, released.y_m, np.radians(released.turn_deg)
    wave = 2.0 * math.pi / surface.size_m[0]
    gradient = 2e-4 * wave * np.stack([np.cos(wave * x), -0.5 * np.sin(wave * y)], axis=-1)
    along = np.cos(turn) * gradient[:, 0] + np.sin(turn) * gradient[:, 1]
    across = np.cos(turn) * gradient[:, 1] - np.sin(turn) * gradient[:, 0]
    tangent = -under.normals[..., :2] / under.normals[..., 2:]
    mean = np.einsum("i,dix->dx", points.weights, tangent)
    # the mean over a tip of 2 mm of a wave of 40 mm falls short by (k a)²/6
    np.testing.assert_allclose(mean, np.column_stack([along, across]), atol=0.02 * 2e-4 * wave)
    # normals and heights are of one surface
    dx = under.places_m[:, 1:] - under.places_m[:, :-1]
    halfway = 0.5 * (tangent[:, 1:] + tangent[:, :-1])
    climbed = np.einsum("dix,dix->di", halfway, dx)
    np.testing.assert_allclose(np.diff(under.rises_m, axis=1), climbed, atol=6e-7)


def test_many_drops_on_a_rough_surface_are_single_drops(marcher):
    inputs = scatter(tilt_std_deg=0.0, **LEAN)
    surface = surface_of(inputs)
    released = draw(inputs, surface.size_m, 0, 2)
    under = ground_under(surface, marcher.body.contact, released, STEEL)
    second = {name: getattr(under, name)[1:] for name in ("normals", "rises_m", "scale")}
    drops = one(marcher.body, **second)
    found, expected = drop_many(marcher, drops), alone(marcher, ground_of(under, 1))
    assert found.rebound_height_m[0] == pytest.approx(expected.rebound_height_m, rel=1e-9)
    assert found.friction_loss_J[0] == pytest.approx(expected.energy.friction_loss_J, rel=1e-7)


def test_the_default_surface_is_as_rough_as_asked_for():
    surface = surface_of(scatter())
    said = surface_facts(surface)
    assert min(surface.size_m) >= 0.038 * (1.0 - 1e-9)
    assert said["rms_height_m"] == pytest.approx(50e-6, rel=0.2)
    assert said["correlation_length_m"] == pytest.approx(5e-3, rel=0.2)
    # of a Gaussian correlation, √2 rms / l
    assert surface.rms_slope(1) == pytest.approx(math.sqrt(2.0) * 0.01, rel=0.2)
    assert surface_of(scatter(flat=True)) is None


# what is drawn


def test_draws_are_those_of_the_drops_number_and_seed():
    size = (0.04, 0.03)
    all_of_them = draw(scatter(seed=7), size, 0, 40)
    part = draw(scatter(seed=7, drops=15), size, 10, 15)
    np.testing.assert_array_equal(part, all_of_them[10:15])
    assert not np.any(draw(scatter(seed=8), size, 0, 40).x_m == all_of_them.x_m)
    np.testing.assert_array_equal(all_of_them.y0_m, np.resize(paper.HEIGHTS_M, 40))


def test_draws_have_the_distributions_that_are_stated():
    n = 4000
    drawn = draw(scatter(tilt_std_deg=2.0, tilt_deg=1.0), (0.04, 0.03), 0, n)
    for values, mean in ((drawn.tilt_deg, 1.0), (drawn.tilt_wide_deg, 0.0)):
        assert np.mean(values) == pytest.approx(mean, abs=4.0 * 2.0 / math.sqrt(n))
        assert np.std(values) == pytest.approx(2.0, rel=4.0 / math.sqrt(2.0 * n))
    assert abs(np.corrcoef(drawn.tilt_deg, drawn.tilt_wide_deg)[0, 1]) < 4.0 / math.sqrt(n)
    for values, end in ((drawn.x_m, 0.04), (drawn.y_m, 0.03), (drawn.turn_deg, 360.0)):
        assert 0.0 <= values.min() < values.max() < end
        assert np.mean(values) == pytest.approx(0.5 * end, abs=4.0 * end / math.sqrt(12.0 * n))


# the command


def test_without_chance_every_drop_is_the_one_of_bristle_drop(tmp_path):
    common = {"model": "beam", "elements": 4, "contact_points": 5, "tilt_deg": 2.0}
    inputs = checked(
        ScatterInputs, {**common, "flat": True, "tilt_std_deg": 0.0, "heights_m": 0.03, "drops": 60}
    )
    run_scatter(inputs, tmp_path, MPI.COMM_SELF)
    document, rows = read(tmp_path)
    expected, _ = run_case(checked(DropInputs, {**common, "height_m": 0.03}), MPI.COMM_SELF)
    ratio = rows.rebound_ratio
    assert np.ptp(ratio) == 0.0
    assert ratio[0] == pytest.approx(expected.rebound_ratio, rel=1e-9)
    assert document["statistics"]["std"]["estimate"] == 0.0
    assert document["check"]["difference"] < 1e-9
    assert all(part["first_order"] is None for part in document["factors"].values())


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A scatter of 120 drops, in three chunks."""
    out = tmp_path_factory.mktemp("scatter")
    run_scatter(scatter(drops=120, seed=11), out, MPI.COMM_SELF)
    return out


def test_what_a_scatter_leaves(done):
    document, rows = read(done)
    ratio = rows.rebound_ratio
    assert len(rows) == document["n_drops"] == 120
    np.testing.assert_allclose(ratio, rows.rebound_height_m / rows.y0_m)
    assert document["statistics"]["mean"]["estimate"] == pytest.approx(ratio.mean())
    assert document["statistics"]["std"]["estimate"] == pytest.approx(ratio.std(ddof=1))
    assert ratio.std() > 0.01
    # with the axial force on the slope a step closes to what its iteration leaves
    assert rows.closure_relative.max() < 1e-3
    assert document["check"]["n"] == 8
    assert document["check"]["difference"] < 1e-9
    assert document["drops_per_second"] > 0.0
    assert set(document["samples_of_26"]) == {"mean", "std", "slope", "r_squared"}
    page = (done / "report.html").read_text()
    for words in ("Scatter of the rebound", "0.65", "Spearman"):
        assert words in page
    for name in ("histogram", "cloud", "lean"):
        assert (done / "figures" / f"{name}.svg").stat().st_size > 1000


def test_a_scatter_repeats_from_its_own_result(done, tmp_path):
    ignored = (*DROP_FLAGS, *LIST_FLAGS)
    again = inputs_of(ScatterInputs, {}, SCATTER_FLAGS, done / "scatter.json", ignored)
    assert again == scatter(drops=120, seed=11)
    flat = inputs_of(ScatterInputs, {"flat": True}, SCATTER_FLAGS, done / "scatter.json", ignored)
    assert flat.rms_height_m is None
    run_scatter(again, tmp_path, MPI.COMM_SELF)
    assert (tmp_path / "drops.csv").read_bytes() == (done / "drops.csv").read_bytes()


def test_resume_does_what_is_missing_and_no_more(done, tmp_path, monkeypatch):
    lines = (done / "cases.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "cases.jsonl").write_text("".join(lines[:3]) + lines[3][:50])
    claim(tmp_path, "cases.jsonl")
    computed = []
    drop_many = scatter_drops.drop_many

    def counted(marcher, drops):
        computed.append(len(drops))
        return drop_many(marcher, drops)

    monkeypatch.setattr(scatter_drops, "drop_many", counted)
    inputs = scatter(drops=120, seed=11)
    run_scatter(inputs, tmp_path, MPI.COMM_SELF, resume=True)
    assert sorted(computed) == [1] * 8 + [20]  # those that are checked, and the last chunk
    computed.clear()
    assert (tmp_path / "drops.csv").read_bytes() == (done / "drops.csv").read_bytes()
    run_scatter(inputs, tmp_path, MPI.COMM_SELF, resume=True)
    assert not computed
    with pytest.raises(InputError, match="--resume.*--tilt-std is 1.0 there, 2.0 is asked for"):
        run_scatter(scatter(drops=120, seed=11, tilt_std_deg=2.0), tmp_path, resume=True)


def test_a_scatter_that_is_refused_leaves_what_can_be_resumed(done, tmp_path):
    journal = tmp_path / "cases.jsonl"
    journal.write_text("".join((done / "cases.jsonl").read_text().splitlines(keepends=True)[:3]))
    claim(tmp_path, journal.name)
    before = journal.read_bytes()
    (tmp_path / "bad.csv").write_text("# spacing_m = 1e-5\n1,2,x\n")
    with pytest.raises(InputError, match=r"--surface: .*bad.csv:2: 'x' is not a number"):
        run_scatter(scatter(drops=120, surface=str(tmp_path / "bad.csv")), tmp_path, MPI.COMM_SELF)
    assert journal.read_bytes() == before
    assert not (tmp_path / "cases.previous.jsonl").exists()


def test_a_drop_that_fails_is_left_out_and_told(tmp_path, monkeypatch):
    drop_many = scatter_drops.drop_many
    bad = draw(scatter(), (0.038, 0.038), 0, 130).tilt_deg[7]

    def fails(marcher, drops):
        if np.isin(bad, drops.tilt_deg).any():
            raise ComputationError("drop 0: it fell over")
        return drop_many(marcher, drops)

    monkeypatch.setattr(scatter_drops, "drop_many", fails)
    run_scatter(scatter(drops=130), tmp_path, MPI.COMM_SELF)
    document, rows = read(tmp_path)
    assert document["failed"] == {"7": "it fell over"}
    assert 7 not in set(rows["drop"])
    assert len(rows) == 129
    assert "1 of 130 drops failed" in document["warnings"][-1]
    assert "1 of 130 drops failed" in (tmp_path / "report.html").read_text()
    bad = np.append(bad, draw(scatter(), (0.038, 0.038), 0, 130).tilt_deg[20])
    with pytest.raises(ComputationError, match="2 of 130 drops failed, the first is drop 7"):
        run_scatter(scatter(drops=130), tmp_path, MPI.COMM_SELF)


@pytest.mark.parametrize("model", [pytest.param("beam", marks=pytest.mark.campaign), "reduced"])
def test_ranks_change_nothing(tmp_path, model):
    options = f"--model {model} --elements 4 --cells 1 1 20 --contact-points 3 --drops 110".split()
    run = mpirun(
        2, "-m", "bristle.studies.scatter", *options, "--out", tmp_path / "2", timeout_s=400.0
    )
    assert run.returncode == 0, run.stderr
    inputs = scatter(model=model, cells=(1, 1, 20), contact_points=3, drops=110)
    run_scatter(inputs, tmp_path / "1", MPI.COMM_SELF)
    assert (tmp_path / "1/drops.csv").read_bytes() == (tmp_path / "2/drops.csv").read_bytes()
    one, two = (read(tmp_path / ranks)[0] for ranks in "12")
    for key in ("inputs", "statistics", "factors", "samples_of_26", "check", "surface"):
        assert one[key] == two[key]
    assert (one["check"]["reduction_error"] is None) == (model == "beam")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"model": "solid"}, "--model: a scatter takes beam or reduced, not solid"),
        ({"drops": 0}, "--drops: .* greater than or equal to 1"),
        ({"seed": -1}, "--seed: "),
        ({"tilt_std_deg": 40.0}, "--tilt-std: .* less than or equal to 15"),
        ({"contact": "nitsche"}, "--contact: a scatter takes penalty or augmented"),
        ({"kn_N_m": "inf", "contact": "augmented"}, "--kn: a scatter needs a finite stiffness"),
        ({"slope_deg": 1.0}, "--slope: the slope comes from the surface"),
        ({"flat": True, "rms_height_m": 1e-5}, "--rms-height: has no meaning with --flat"),
        ({"heights_m": ""}, "--heights: must be numbers separated by commas"),
        ({"tilt": 3}, "tilt: is no known input"),
    ],
)
def test_bad_input_is_refused_in_plain_words(values, words):
    with pytest.raises(InputError, match=words):
        scatter(**values)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"surface": "nowhere.npz"}, "--surface: .*nowhere.npz: No such file"),
        ({"surface": "table.xlsx"}, "--surface: .*table.xlsx: a surface is read from"),
        (
            {"correlation_length_m": 1e-5},
            "--correlation-length: with 1e-05 m the surface needs a grid of 38000 × 38000 nodes, "
            "and 4096 × 4096 are the most; take a longer one",
        ),
        ({"correlation_length_m": 1.0}, "--correlation-length: with 1 m .*; take a shorter one"),
    ],
)
def test_a_surface_that_cannot_be_had_is_told(tmp_path, monkeypatch, values, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "table.xlsx").touch()
    with pytest.raises(InputError, match=words):
        run_scatter(scatter(**values), tmp_path / "out", MPI.COMM_SELF)
