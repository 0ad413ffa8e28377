"""Made datasets hold what they say, hide it, and come out the same again."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import NdBSpline, make_interp_spline

from bristle.solver import paper
from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle
from bristle.solver.contact.laws import Linear
from bristle.solver.effects.base import Scene
from bristle.solver.effects.library import EFFECTS
from bristle.solver.errors import InputError
from bristle.solver.fall import dragged_fall, fallen, risen
from bristle.studies.data.datasets import read_drops
from bristle.studies.inputs.choices import Noise, Strange
from bristle.studies.inputs.sources import checked
from bristle.studies.inputs.study_fields import Recipe
from bristle.studies.loop.responses import emulator as emulator_module
from bristle.studies.loop.responses.emulator import PLAIN_STEP, Emulator
from bristle.studies.loop.responses.table import Axis, Table, coefficients, evaluate
from bristle.studies.loop.responses.table_drops import outcomes_of, quantities
from bristle.studies.running.mark import MARK
from bristle.studies.synth import FILES, make, prepare_dataset, table_of, truth_of, write_made

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def body():
    return beam_body(Bristle(), 8, points=3, second_order=True)


def test_the_same_recipe_gives_the_same_table_another_seed_another(body):
    recipe = Recipe(drops=10, seed=3)
    assert table_of(make(recipe, body)) == table_of(make(recipe, body))
    assert table_of(make(recipe, body)) != table_of(make(Recipe(drops=10, seed=4), body))


def test_a_written_dataset_reads_as_made_and_keeps_its_secret(body, tmp_path):
    recipe = Recipe(effects=["contact_damping:c_N_s_m=7"], drops=12)
    made = make(recipe, body)
    write_made(made, tmp_path / "data", tmp_path / "truth.json")
    found = read_drops(tmp_path / "data")
    columns = ("y0_m", "y1_m", "contact_time_s", "peak_force_N")
    for name, values in zip(columns, made.measured.T, strict=True):
        assert getattr(found, name) == pytest.approx(values, rel=1e-5)
    shown = "".join(path.read_text() for path in (tmp_path / "data").iterdir())
    assert "contact_damping" not in shown
    assert "7" not in (tmp_path / "data" / "dataset.toml").read_text().split("[measurement]")[0]
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["effects"] == [{"name": "contact_damping", "parameters": {"c_N_s_m": 7.0}}]
    assert np.array(truth["without_noise"]) == pytest.approx(made.true)


def test_films_and_a_table_of_drops_do_not_lie_beside_another_truth(body, tmp_path):
    made, folder, truth = make(Recipe(drops=6), body), tmp_path / "data", tmp_path / "truth.json"
    films = made.recipe.model_copy(update={"film": True})
    one = replace(made, recipe=films, scenes=made.scenes[:1])
    write_made(made, folder, truth)
    (folder / "notes.txt").write_text("the user's")
    write_made(one, folder, truth)
    kept = {"notes.txt", MARK}
    assert {path.name for path in folder.iterdir()} == {"films", *kept}
    write_made(made, folder, truth)
    assert {path.name for path in folder.iterdir()} == {"drops.csv", "dataset.toml", *kept}


def test_the_truth_may_not_lie_in_the_dataset(tmp_path):
    with pytest.raises(InputError, match="--truth"):
        prepare_dataset(tmp_path / "data", tmp_path / "data" / "deep" / "truth.json", *FILES)
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("noise", list(Noise))
def test_errors_are_as_large_as_declared(body, noise):
    recipe = Recipe(drops=600, heights_m=(0.02,), noise=noise, seed=5)
    made = make(recipe, body)
    sigma = np.array([recipe.sigma_y_m, recipe.sigma_y_m, recipe.sigma_t_s, recipe.sigma_force_N])
    errors = (made.measured - made.true) / sigma
    wide = np.sqrt(1.0 + 0.05 * 24.0) if noise is Noise.OUTLIERS else 1.0
    # the variance of heavy tails has no variance of its own: their middle half is asked instead
    if noise is Noise.HEAVY:
        half = np.quantile(np.abs(errors), 0.5)
        assert half == pytest.approx(0.7649 / np.sqrt(3.0), rel=0.1)
    else:
        assert np.std(errors) == pytest.approx(wide, rel=0.12)
    if noise is Noise.CORRELATED:
        assert np.mean(errors[1:] * errors[:-1]) == pytest.approx(0.5, abs=0.1)


def test_unlisted_effects_change_the_height_after_alone(body):
    plain = make(Recipe(drops=20), body)
    for strange in Strange:
        made = make(Recipe(drops=20, unlisted=(strange, 0.05)), body)
        assert np.array_equal(made.true[:, [0, 2, 3]], plain.true[:, [0, 2, 3]])
        changed = made.true[:, 1] / plain.true[:, 1] - 1.0
        assert 0.02 < np.abs(changed).max() <= 0.05 + 1e-12
        assert truth_of(made)["unlisted"] == str(strange)


@pytest.mark.parametrize(
    ("given_", "word"),
    [
        ({"effects": ["gravity"]}, "--effect"),
        ({"noise": "pink"}, "--noise"),
        ({"unlisted": "session-shift"}, "--unlisted"),
        ({"unlisted": "session-shift=2"}, "--unlisted"),
        ({"unlisted": "ghost=0.1"}, "--unlisted"),
    ],
)
def test_nonsense_is_refused(given_, word):
    with pytest.raises(InputError, match=word):
        checked(Recipe, given_)


# tables


@given(seed=st.integers(0, 1000), axes=st.integers(1, 4))
@settings(max_examples=25, deadline=None)
def test_splines_reproduce_cubics_and_their_nodes(seed, axes):
    """A product of cubics lies in the space of splines, so it is met everywhere."""
    rng = np.random.default_rng(seed)
    cubics = rng.normal(size=(3, axes, 4))
    sizes = rng.integers(5, 8, size=axes)

    def values(points):
        out = np.ones((len(points), 3))
        for q in range(3):
            for a in range(axes):
                out[:, q] *= np.polyval(cubics[q, a], points[:, a] / sizes[a])
        return out

    grid = np.stack(np.meshgrid(*map(np.arange, sizes), indexing="ij"), axis=-1).reshape(-1, axes)
    table = coefficients(values(grid.astype(float)).reshape(*sizes, 3), axes)
    points = rng.uniform(0.0, sizes - 1.0, size=(40, axes))
    found = np.empty((40, 1, 3))
    counts, first, others = np.array(table.shape[:-1]), points[:, :1].copy(), points[:, 1:].copy()
    evaluate(table.reshape(-1, 3), counts, first, others, found)
    assert found[:, 0] == pytest.approx(values(points), rel=1e-8, abs=1e-8 * np.abs(table).max())


SHAPES = {
    "drops": [(2, 1, 7), (2, 1, 1), (2, 1, 1), (1,)],
    "drops and nodes": [(2, 1, 7), (2, 1, 1), (2, 3, 1), (3, 1)],
    "heights by node": [(2, 3, 7), (2, 3, 1), (2, 3, 1), (3, 1)],
    "each its own": [(7,), (2, 1, 7), (2, 3, 1), ()],
    "numbers": [(), (), (), ()],
}


@pytest.mark.parametrize("shapes", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("count", [3, 6])
def test_a_table_read_at_once_is_a_spline_at_each_place(shapes, count, rng):
    """Against SciPy's."""
    axes = (Axis(0.01, 0.06, 4, "root"), Axis(1e4, 1e8, 5, "log"), Axis(0, 8, 6), Axis(0, 90, 4))
    values = rng.normal(size=(4, 5, 6, 4, count))
    nodes = [np.arange(each.n, dtype=float) for each in axes]
    spline = values
    knots = []
    for axis, each in enumerate(nodes):
        one = make_interp_spline(each, spline, axis=axis)
        knots.append(one.t)
        spline = np.moveaxis(one.c, 0, axis) if axis else one.c
    exact = NdBSpline(tuple(knots), spline, 3)
    places = [rng.uniform(a.low, a.high, shape) for a, shape in zip(axes, shapes, strict=True)]
    where = np.broadcast_arrays(*(a.where(x) for a, x in zip(axes, places, strict=True)))
    expected = np.moveaxis(exact(np.stack(where, axis=-1)), -1, 0)
    found = Table(axes, coefficients(values, 4)).at(*places)
    assert found.shape == expected.shape
    assert found == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("how", ["even", "log", "root"])
def test_an_axis_knows_where_its_nodes_are(how):
    axis = Axis(0.5, 8.0, 7, how)
    assert axis.where(axis.nodes()) == pytest.approx(np.arange(7.0))
    assert axis.where(np.array([-1.0 if how == "even" else 0.1, 100.0])) == pytest.approx([0, 6])


@pytest.mark.parametrize(
    "name", ["contact_damping", "hunt_crossley", "stiffening_contact", "plastic_contact"]
)
def test_a_table_is_the_simulation_between_its_nodes(name):
    """To a tenth of what the instruments of a made dataset show of 48 drops."""
    emulator = Emulator(Bristle(), paper.GRAVITY_M_S2, 0.004, 0.064)
    rng = np.random.default_rng(1)
    kind = EFFECTS[name]
    only, *_ = kind.parameters
    for _ in range(6):
        height, kn = rng.uniform(0.01, 0.05), 2e6 * 10.0 ** rng.uniform(-0.5, 0.5)
        value = only.null + (only.high - only.null) * rng.uniform(0.05, 0.5)
        scene = Scene(height_m=height, beta_s=paper.BETA_S, law=Linear(kn))
        where = np.asarray(height), np.asarray(kn)
        logs = emulator.plain.at(*where) + emulator.change(name, *where, value)
        told = np.exp(logs) * emulator.reference(*where)
        (direct,) = emulator.observed(
            [kind(value).enter(scene)], PLAIN_STEP * emulator.step_s(kn), 0.0
        )
        assert told[0] == pytest.approx(direct[0], rel=1e-3)
        assert told[2] == pytest.approx(direct[2], rel=2e-3)


def test_other_heights_and_another_friction_find_the_drops_that_are_there(monkeypatch):
    """Of the same bristle under the same gravity; friction counts only where something leans."""
    simulated, kept = [], {}

    def observed(_, scenes, its, friction):
        simulated.extend(scene.height_m for scene in scenes)
        return np.ones((len(scenes), 3))

    def cached_each(keys, make):
        missing = [i for i, key in enumerate(keys) if key not in kept]
        kept.update(zip([keys[i] for i in missing], make(missing) if missing else (), strict=True))
        return [kept[key] for key in keys]

    monkeypatch.setattr(Emulator, "observed", observed)
    monkeypatch.setattr(emulator_module, "cached_each", cached_each)
    first = Emulator(Bristle(), 9.8, 0.009, 0.05, friction=0.3)
    for emulator, heights in (
        (first, [8, 16, 32, 64]),
        (replace(first, lowest_m=0.02, highest_m=0.1, friction=0.2), [128]),
        (replace(first, lowest_m=0.02, highest_m=0.03), [4]),  # a cubic needs four
        (replace(first, gravity_m_s2=9.81), [8, 16, 32, 64]),
    ):
        simulated.clear()
        table = emulator.plain
        assert sorted({round(1e3 * height, 9) for height in simulated}) == heights
        assert table.axes[0].low <= emulator.lowest_m < emulator.highest_m <= table.axes[0].high
    for friction, there in ((0.3, False), (0.2, False), (0.3, True)):
        simulated.clear()
        replace(first, friction=friction).of("bristle_tilt")
        assert (not simulated) == there


def test_a_refined_table_is_near_the_simulation_and_the_plain_one_where_nothing_yields(
    monkeypatch,
):
    """To a few hundredths, from where fits to simulations find the rest; above yield, exactly.
    Of a tenth of the stiffnesses, on a tenth of the nodes."""
    for name, nodes in {"KN_NODES": 25, "EFFECT_KN_NODES": 8, "REFINED_KN_NODES": 4}.items():
        monkeypatch.setattr(emulator_module, name, nodes)
    emulator = Emulator(Bristle(), paper.GRAVITY_M_S2, 0.004, 0.064, (5e5, 8e6))
    rng = np.random.default_rng(3)
    misses = []
    for _ in range(8):
        height, kn = rng.uniform(0.01, 0.06), 2e6 * 10.0 ** rng.uniform(-0.5, 0.5)
        where = np.asarray(height), np.asarray(kn)
        more = rng.uniform(0.0, 0.2), 10.0 ** rng.uniform(0.0, 0.8)
        most = float(emulator.scale("plastic_contact", *where))
        value = rng.uniform(0.2, 0.9) * most
        scene = Scene(height_m=height, beta_s=paper.BETA_S, law=Linear(kn))
        yielding = EFFECTS["plastic_contact"](value, *more).enter(scene)
        found = np.log(emulator.observed([yielding, scene], emulator.step_s(kn), 0.0))
        misses.append(
            emulator.change("plastic_contact", *where, value, *more) - found[0] + found[1]
        )
        beyond = emulator.change("plastic_contact", *where, 5.0 * most, *more)
        assert beyond == pytest.approx(0.0, abs=1e-12)
    assert np.median(np.abs(misses), axis=0) == pytest.approx(0.0, abs=0.02)


def test_a_slope_is_a_slope_of_the_ground_not_of_each_point(body):
    """A bristle over a slope falls as one that leans the other way over level ground."""
    its, g = 5e-6, paper.GRAVITY_M_S2
    sloping = Scene(height_m=1e-3, beta_s=paper.BETA_S, law=Linear(2e6), slope_deg=1.0)
    leaning = Scene(height_m=1e-3, beta_s=paper.BETA_S, law=Linear(2e6), tilt_deg=-1.0)
    found = quantities(outcomes_of(body, [sloping, leaning], g, its, 0.0))
    # the slope turns the impact's force by 1°, and gravity's share across it: cos 1° and some
    assert found[0, 2] == pytest.approx(found[1, 2], rel=5e-3)
    assert found[0, 1] == pytest.approx(found[1, 1], rel=5e-3)


@given(height=st.floats(1e-3, 0.1), speed=st.floats(-0.5, 0.5), drag=st.floats(1e-6, 1.0))
@settings(max_examples=50, deadline=None)
def test_falls_of_many_drops_are_those_of_one(height, speed, drag):
    _, end = dragged_fall(height, paper.GRAVITY_M_S2, speed, drag)
    many = fallen(np.array([height]), paper.GRAVITY_M_S2, speed, drag)
    assert many[0] == pytest.approx(end**2 / (2.0 * paper.GRAVITY_M_S2), rel=1e-6)
    assert risen(np.array([height]), drag)[0] == pytest.approx(risen(height, drag), rel=1e-6)


@given(height=st.floats(1e-3, 0.1), speed=st.floats(0.0, 0.5), drag=st.floats(1e-6, 1.0))
@settings(max_examples=50, deadline=None)
def test_drops_that_fall_in_different_ways_do_not_mix(height, speed, drag):
    """v² = v0² + 2 g y without drag; thrown up, a drop ends as one let go where it turned."""
    g = paper.GRAVITY_M_S2
    starts, drags = np.array([speed, speed, -speed, 0.0]), np.array([0.0, drag, drag, drag])
    turning = height + np.log1p(drag * speed**2 / g) / (2.0 * drag)
    found = fallen(np.array([height, height, height, turning]), g, starts, drags)
    assert found[0] == pytest.approx(height + speed**2 / (2.0 * g), rel=1e-12)
    assert found[2] == pytest.approx(found[3], rel=1e-12)
    assert found[1] <= found[0] * (1.0 + 1e-12)
    assert risen(found, drags)[0] == found[0]
    assert np.all(risen(found[1:], drag) < found[1:])


def test_a_truth_that_was_edited_is_not_replaced(body, tmp_path):
    made, folder, truth = make(Recipe(drops=6), body), tmp_path / "data", tmp_path / "truth.json"
    write_made(made, folder, truth)
    prepare_dataset(folder, truth, *FILES)
    truth.write_text(truth.read_text().replace("{", '{"my_notes": 1,', 1))
    with pytest.raises(InputError, match="--truth"):
        prepare_dataset(folder, truth, *FILES)
    assert "my_notes" in truth.read_text()
