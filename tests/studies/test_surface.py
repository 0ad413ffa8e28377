"""A random surface is the one that was asked for, and what the tip sees of it is consistent."""

import math
import pickle

import numpy as np
import pytest
from scipy import ndimage, sparse

from bristle.studies.surface import phases as surface_phases
from bristle.studies.surface.ground import surface_facts
from bristle.studies.surface.phases import CONCRETE, Composite, Phase, random_phases
from bristle.studies.surface.rough import Roughness, Surface, make_surface, random_heights

pytestmark = pytest.mark.serial

STONE = Composite((Phase("stone", 50e9, 0.2, 1.0),))
MORTAR = Composite(
    (Phase("cement", 12e9, 0.2, 0.4), Phase("sand", 80e9, 0.2, 0.6, grain_size_m=0.5e-3))
)
RMS_M, LENGTH_M = 20e-6, 0.2e-3
STEEL = (207e9, 0.28)


@pytest.fixture(scope="module")
def surface():
    return make_surface(Roughness(RMS_M, LENGTH_M), MORTAR, 4e-3, 25e-6, seed=3)


@pytest.fixture
def places(rng):
    """Places in and far outside the tile."""
    return rng.uniform(-20e-3, 20e-3, (2, 400))


# --- heights ----------------------------------------------------------------------------------


def test_covariance_over_many_draws_is_the_one_asked_for(rng):
    n, roughness = 18, Roughness(RMS_M, 3.0)
    draws = np.array([random_heights(roughness, n, 1.0, rng) for _ in range(3000)]) / RMS_M
    measured = np.fft.ifft2((np.abs(np.fft.fft2(draws)) ** 2).mean(axis=0)).real / n**2
    lag = np.minimum(np.arange(n), n - np.arange(n))
    near = np.hypot(lag[:, None], lag) < n / 3
    wanted = roughness.autocorrelation(np.hypot(lag[:, None], lag))
    # One draw's covariance is off by √2 √(π l² / 2 L²) at most: 0.3, so 0.005 over the draws.
    assert np.abs(measured - wanted)[near].max() < 0.025
    assert draws.mean() == pytest.approx(0.0, abs=0.04)


def test_statistics_over_seeds_are_those_of_the_gaussian_autocorrelation():
    size = 20 * LENGTH_M
    tiles = [
        make_surface(Roughness(RMS_M, LENGTH_M), STONE, size, LENGTH_M / 5, seed)
        for seed in range(40)
    ]
    mean_square = np.mean([surface_facts(tile)["rms_height_m"] ** 2 for tile in tiles])
    # About its own mean a tile lacks the variance of that mean, π l² / L².  Standard error of the
    # mean square: √(π) l / L / √40 = 0.014.
    assert mean_square / RMS_M**2 == pytest.approx(1 - math.pi / 20**2, abs=4 * 0.014)
    lengths = [tile.correlation_length_m() for tile in tiles]
    assert np.mean(lengths) == pytest.approx(LENGTH_M, rel=0.02)
    for axis in (0, 1):
        slopes = [tile.rms_slope(axis) for tile in tiles]
        assert np.sqrt(np.mean(np.square(slopes))) == pytest.approx(
            math.sqrt(2) * RMS_M / LENGTH_M, rel=0.03
        )


def test_statistics_of_a_cosine_are_its_closed_form():
    n, amplitude, waves = 96, 3e-6, 2
    x = np.arange(n) / n
    heights = 7.0 + amplitude * np.cos(2 * np.pi * waves * x) * np.ones((n, 1))
    surface = Surface(heights, 1 / n, np.zeros((n, n), int), STONE)
    measured = surface_facts(surface)
    assert measured["rms_height_m"] == pytest.approx(amplitude / math.sqrt(2), rel=1e-9)
    slope = amplitude * 2 * np.pi * waves / math.sqrt(2)
    assert surface.rms_slope(1) == pytest.approx(slope, rel=1e-4)
    assert measured["rms_slope_x_deg"] == pytest.approx(math.degrees(math.atan(slope)), rel=1e-4)
    assert surface.rms_slope(0) == pytest.approx(0.0, abs=1e-12)
    # Averaged over directions the autocorrelation is J0(2π waves r), 1/e at argument 1.7460.
    length = 1.7460 / (2 * np.pi * waves)
    assert measured["correlation_length_m"] == pytest.approx(length, rel=0.01)
    assert measured["fractions"] == {"stone": 1.0}


def test_same_seed_same_surface_and_heights_do_not_depend_on_phases():
    def make(seed, composite=STONE):
        return make_surface(Roughness(RMS_M, LENGTH_M), composite, 2e-3, 50e-6, seed)

    assert np.array_equal(make(5).heights_m, make(5).heights_m)
    assert np.array_equal(make(5).heights_m, make(5, MORTAR).heights_m)
    assert np.array_equal(make(5, MORTAR).phase, make(5, MORTAR).phase)
    assert not np.array_equal(make(5).heights_m, make(6).heights_m)
    assert not np.array_equal(make(5, MORTAR).phase, make(6, MORTAR).phase)


def test_no_roughness_is_the_plane(places):
    plane = make_surface(Roughness(0.0, LENGTH_M), STONE, 1e-3, 0.1e-3, seed=0)
    seen = plane.patch(*places)
    assert not seen.heights_m.any()
    assert np.array_equal(seen.normals, np.tile([0.0, 0.0, 1.0], (400, 1)))
    assert plane.correlation_length_m() is None


# --- what the tip sees ------------------------------------------------------------------------


def test_patch_goes_through_the_nodes_and_repeats(surface, places):
    ny, nx = surface.heights_m.shape
    j, i = np.divmod(np.arange(ny * nx), nx)
    at_nodes = surface.patch(i * surface.spacing_m, j * surface.spacing_m)
    assert at_nodes.heights_m == pytest.approx(surface.heights_m.ravel(), abs=1e-12 * RMS_M)
    assert np.array_equal(at_nodes.phase, surface.phase.ravel())
    x, y = places
    here = surface.patch(x, y)
    there = surface.patch(x + 7 * surface.size_m[0], y - 3 * surface.size_m[1])
    assert there.heights_m == pytest.approx(here.heights_m, abs=1e-9 * RMS_M)
    assert there.normals == pytest.approx(here.normals, abs=1e-9)
    assert (there.phase == here.phase).mean() > 0.99  # rounding at a phase's border


def test_no_step_nor_kink_where_the_tile_repeats(surface):
    y = np.linspace(0, surface.size_m[1], 50)
    # The last is an x that the remainder rounds up to the period itself.
    for seam in (0.0, surface.size_m[0], -5 * surface.size_m[0], -1e-25):
        left, right = (surface.patch(np.full(50, seam + d), y) for d in (-1e-12, 1e-12))
        assert right.heights_m == pytest.approx(left.heights_m, abs=1e-12)
        assert right.normals == pytest.approx(left.normals, abs=1e-6)


def test_normals_are_the_gradient_of_the_heights(surface, places):
    x, y = places
    seen, step = surface.patch(x, y), 1e-8
    rise = [
        (surface.patch(x + dx, y + dy).heights_m - surface.patch(x - dx, y - dy).heights_m)
        / (2 * step)
        for dx, dy in ((step, 0.0), (0.0, step))
    ]
    assert np.linalg.norm(seen.normals, axis=1) == pytest.approx(np.ones(400), abs=1e-14)
    assert (seen.normals[:, 2] > 0).all()
    slopes = -seen.normals[:, :2] / seen.normals[:, 2:]
    assert slopes == pytest.approx(np.transpose(rise), abs=1e-6)
    assert np.abs(slopes).max() > 0.2


def test_heights_converge_at_fourth_order_and_slopes_at_third(places):
    x, y = places / 20e-3  # the tile is 1 × 1.5 long

    def errors(n):
        nodes_x, nodes_y = np.arange(n) / n, np.arange(3 * n // 2)[:, None] / n
        heights = np.sin(2 * np.pi * nodes_x) * np.cos(2 * np.pi * nodes_y / 1.5)
        seen = Surface(heights, 1 / n, np.zeros(heights.shape, int), STONE).patch(x, y)
        exact = np.sin(2 * np.pi * x) * np.cos(2 * np.pi * y / 1.5)
        slope = 2 * np.pi * np.cos(2 * np.pi * x) * np.cos(2 * np.pi * y / 1.5)
        found = -seen.normals[:, 0] / seen.normals[:, 2]
        return [np.sqrt(np.mean((seen.heights_m - exact) ** 2)), np.std(found - slope)]

    rates = np.log2(np.array(errors(20)) / errors(40))
    assert rates == pytest.approx([4, 3], abs=0.2)


def test_surface_is_a_value_that_travels(surface, places):
    seen = surface.patch(*places)
    again = pickle.loads(pickle.dumps(surface)).patch(*places)
    assert np.array_equal(again.heights_m, seen.heights_m)
    with pytest.raises(ValueError, match="read-only"):
        surface.heights_m[0, 0] = 1.0


# --- phases and stiffness ---------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_concrete_has_its_fractions_on_a_tile_of_many_grains(seed):
    made = make_surface(Roughness(0.0, 1e-3), Composite(), 40e-3, 0.1e-3, seed)
    assert made.fractions == pytest.approx([0.30, 0.28, 0.42], abs=0.003)


def test_fractions_of_small_windows_are_right_on_the_average(monkeypatch):
    monkeypatch.setattr(surface_phases, "SAMPLES", 4000)
    coarse = Composite(
        (Phase("mortar", 30e9, 0.2, 0.58), Phase("coarse", 69e9, 0.2, 0.42, grain_size_m=9.5e-3))
    )
    means = [
        random_phases(coarse, (20, 30), 0.1e-3, np.random.default_rng(seed)).mean()
        for seed in range(400)
    ]
    assert np.std(means) > 0.3  # most windows are all grain or all mortar
    assert np.mean(means) == pytest.approx(0.42, abs=4 * np.std(means) / 20)


def test_grains_have_their_size_and_go_on_across_the_seam():
    made = make_surface(Roughness(0.0, 1e-3), MORTAR, 5e-3, 10e-6, seed=2)
    sand = made.phase == 1
    labels, count = ndimage.label(sand)
    seams = [(labels[:, 0], labels[:, -1]), (labels[0], labels[-1])]
    pairs = np.concatenate([np.column_stack(s)[(s[0] > 0) & (s[1] > 0)] for s in seams])
    graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), (count + 1, count + 1))
    count = sparse.csgraph.connected_components(graph, directed=False)[0] - 1
    area = sand.sum() * made.spacing_m**2 / count
    assert math.sqrt(area * 4 / math.pi) == pytest.approx(0.5e-3, rel=0.02)
    for axis in (0, 1):
        changes = (made.phase != np.roll(made.phase, 1, axis)).sum(axis=1 - axis)
        assert changes[0] < changes[1:].max() < 100  # two unrelated edges differ at 240 nodes


def test_contact_modulus_is_johnsons():
    def modulus(youngs_Pa, poisson, *bristle):
        return Composite((Phase("x", youngs_Pa, poisson, 1.0),)).contact_moduli_Pa(*bristle)

    assert modulus(69e9, 0.2, *STEEL) == pytest.approx(1 / (0.96 / 69e9 + (1 - 0.28**2) / 207e9))
    # A rigid partner leaves the other's plane-strain modulus; two alike halve it.
    assert modulus(12e9, 0.0, math.inf, 0.3) == pytest.approx(12e9)
    assert modulus(2e9, 0.0, 2e9, 0.0) == pytest.approx([1e9])


def test_stiffness_factor_has_mean_one_over_the_surface(surface):
    ny, nx = surface.heights_m.shape
    j, i = np.divmod(np.arange(ny * nx), nx)
    seen = surface.patch(i * surface.spacing_m, j * surface.spacing_m)
    factors = surface.stiffness_factors(*STEEL)
    assert factors[seen.phase].mean() == pytest.approx(1.0, rel=1e-12)
    cement, sand = factors
    assert 0 < cement < 1 < sand
    moduli = [1 / (0.96 / youngs_Pa + (1 - 0.28**2) / 207e9) for youngs_Pa in (12e9, 80e9)]
    assert sand / cement == pytest.approx(moduli[1] / moduli[0])


# --- bad input --------------------------------------------------------------------------------


def phase(**changes):
    return Phase(
        **({"name": "x", "youngs_Pa": 1e9, "poisson": 0.2, "area_fraction": 1.0} | changes)
    )


def rough(size_m=2e-3, spacing_m=50e-6):
    return make_surface(Roughness(RMS_M, LENGTH_M), STONE, size_m, spacing_m, seed=0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Roughness(-1e-6, 1e-4), "rms_height_m must be positive and finite"),
        (lambda: Roughness(False, 1e-4), "rms_height_m must be a number"),
        (lambda: Roughness(1e-6, 0.0), "correlation_length_m must be positive"),
        (lambda: Roughness(1e-6, math.nan), "correlation_length_m must be positive and finite"),
        (lambda: phase(name=" "), "name\n.* match"),
        (lambda: phase(youngs_Pa=-1.0), "youngs_Pa\n.* greater than 0"),
        (lambda: phase(poisson=0.51), "poisson\n.* less than or equal to 0.5"),
        (lambda: phase(poisson="a"), "poisson\n.* valid number"),
        (lambda: phase(area_fraction=1.2), "area_fraction\n.* less than or equal to 1"),
        (lambda: phase(grain_size_m=0.0), "grain_size_m\n.* greater than 0"),
        (lambda: Composite(()), "exactly one matrix"),
        (lambda: Composite(CONCRETE[1:]), "exactly one matrix"),
        (lambda: Composite(CONCRETE[:2]), "the area fractions must sum to 1, not 0.58"),
        (lambda: Composite((1, 2)), "instance of Phase"),
        (
            lambda: Composite((phase(area_fraction=0.5), phase(area_fraction=0.5, grain_size_m=1))),
            "different names, not x, x",
        ),
        (lambda: rough(size_m=2.02e-3), "0.00202 is not a whole number of spacings of 5e-05 m"),
        (lambda: rough(size_m=1e-3), "too short to repeat: .* at least 0.001051 m"),
        (lambda: rough(spacing_m=0.1e-3), "too coarse: .* at most 6.667e-05 m"),
        (lambda: rough(size_m=1.0, spacing_m=1e-5), "100000 × 100000 nodes"),
        (lambda: rough(size_m=-1.0), "size_m must be positive"),
        (
            lambda: make_surface(Roughness(0.0, 1e-3), MORTAR, 4e-3, 0.2e-3, 0),
            "too coarse for the sand: grains of 0.0005 m need 0.0001667 m",
        ),
    ],
)
def test_wrong_input_is_refused_in_words(make, message):
    with pytest.raises(ValueError, match=message):
        make()
