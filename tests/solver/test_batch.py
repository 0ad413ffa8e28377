"""Many drops at once give what each gives alone."""

from dataclasses import replace

import numpy as np
import pytest

from bristle.solver import batch
from bristle.solver.batch import (
    COLUMN,
    LONGEST_S,
    PLANES,
    Drops,
    drop_each,
    drop_many,
    symmetric_part,
)
from bristle.solver.bodies.beam import beam_body
from bristle.solver.bodies.reduced import reduce_solid
from bristle.solver.bristle import Bristle, Material, Rectangle
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import (
    Adhesive,
    Coulomb,
    Damped,
    HuntCrossley,
    Linear,
    Plastic,
)
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.errors import ComputationError
from bristle.solver.ground import Ground
from bristle.solver.rigid import leaning, matrix_of, slope_normal
from bristle.solver.time import modal_march
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme

pytestmark = pytest.mark.serial
G, ITS = 9.8, 1e-5


def method_of(kn, mu, enforcement=Enforcement.PENALTY):
    return ContactMethod(Linear(kn), enforcement=enforcement, friction=Coulomb(mu))


def marcher_of(body, enforcement=Enforcement.PENALTY, its=ITS):
    return Marcher(body, method_of(2e6, 0.5, enforcement), TimeScheme.average(), its, G)


def leaning_drops(body, rng, count, spread_deg=5.0, **fixed):
    values = {
        "height_m": rng.uniform(0.01, 0.05, count),
        "kn_N_m": 10.0 ** rng.uniform(5.0, 7.0, count),
        "tilt_deg": rng.uniform(-spread_deg, spread_deg, count),
        "tilt_wide_deg": rng.uniform(-spread_deg, spread_deg, count),
        "mu": rng.choice([0.0, 0.2, 0.5], count),
    }
    return Drops.on_plane(len(body.contact.weights), **(values | fixed))


def alone(body, drops, i, enforcement=Enforcement.PENALTY):
    method = method_of(drops.kn_N_m[i], drops.mu[i], enforcement)
    plan = DropPlan(drops.height_m[i], method, ITS, G)
    tilts = {"tilt_deg": drops.tilt_deg[i], "tilt_wide_deg": drops.tilt_wide_deg[i]}
    on_planes = body.contact.places_m @ matrix_of(leaning(*tilts.values())).T
    on_planes[:, 2] = drops.rises_m[i]
    offsets = (drops.normals[i] * on_planes).sum(axis=1)
    ground = Ground(drops.normals[i], offsets, drops.scale[i])
    plan = replace(plan, ground=ground, **tilts)
    return simulate(ModalFrame(body), plan)


def assert_the_same(
    body, drops, outcome, enforcement=Enforcement.PENALTY, rel=1e-9, tip_m=0.0, closure=1e-9
):
    for i in range(len(drops)):
        one = alone(body, drops, i, enforcement)
        height, speed = drops.height_m[i], one.impact_speed_m_s
        assert outcome.n_contacts[i] == one.n_contacts
        assert outcome.n_steps[i] == one.n_steps
        top = pytest.approx(one.rebound_height_m, abs=rel * height + tip_m)
        assert outcome.rebound_height_m[i] == top
        top = pytest.approx(one.cm_rebound_height_m, abs=rel * height)
        assert outcome.cm_rebound_height_m[i] == top
        for name in ("contact_time_s", "peak_force_N", "impulse_N_s"):
            assert getattr(outcome, name)[i] == pytest.approx(getattr(one, name), rel=rel)
        velocity = outcome.cm_velocity_after_m_s[i]
        assert velocity == pytest.approx(one.cm_velocity_after_m_s, abs=rel * speed)
        spin = [getattr(outcome, f"spin_{axis}_rad_s")[i] for axis in "xyz"]
        assert spin == pytest.approx(one.spin_after_rad_s, abs=1e2 * rel)
        assert outcome.friction_loss_J[i] == pytest.approx(
            one.energy.friction_loss_J, abs=rel * one.energy.initial_J
        )
        off = pytest.approx(one.energy.closure_relative, rel=1e-3, abs=rel)
        assert outcome.closure_relative[i] == off
    assert outcome.closure_relative.max() < closure


@pytest.mark.parametrize("face", [True, False], ids=["face", "point"])
@pytest.mark.parametrize("beta_s", [1.07e-5, 1e-8])
def test_leaning_beams_fall_as_one_alone(beta_s, face, rng):
    body = beam_body(Bristle(material=Material(beta_s=beta_s)), 8, face=face)
    drops = leaning_drops(body, rng, 12)
    assert_the_same(body, drops, drop_many(marcher_of(body), drops))


def test_leaning_beams_of_second_order(rng):
    """The last ones slide for 20 ms, each step solved a dozen times; no model for these keeps
    energy, but the batch is to do as one drop alone does."""
    body = beam_body(Bristle(material=Material(beta_s=1e-8)), 32, second_order=True)
    leans = {"tilt_deg": np.linspace(1.0, 8.0, 8), "tilt_wide_deg": 0.0, "mu": 0.0}
    drops = leaning_drops(body, rng, 8, height_m=0.05, kn_N_m=2e6, **leans)
    assert_the_same(body, drops, drop_many(marcher_of(body), drops), rel=1e-6, closure=np.inf)


@pytest.mark.parametrize(
    "laws",
    [
        [Damped(1e6, 0.0), Damped(2e6, 3.0), Damped(2e6, 20.0)],
        [HuntCrossley(1e6, 0.1), HuntCrossley(3e6, 0.1), HuntCrossley(2e6, 1.0)],
        [Plastic(2e6, 5.0), Plastic(2e6, 20.0), Plastic(2e6, 60.0)],
    ],
    ids=["dashpot", "hunt_crossley", "plastic"],
)
@pytest.mark.parametrize("tilt_deg", [0.0, 2.0])
def test_drops_of_one_batch_have_laws_of_their_own(laws, tilt_deg, rng):
    body = beam_body(Bristle(), 8)
    lean = {"tilt_deg": tilt_deg, "tilt_wide_deg": 0.0, "mu": 0.5}
    drops = leaning_drops(body, rng, 3, kn_N_m=[law.kn_N_m for law in laws], **lean)
    numbers = {"laws": np.array([law.parameters for law in laws])}
    numbers["damping"] = np.array([law.damping for law in laws])
    marcher = marcher_of(body)
    together = np.array(drop_many(marcher.with_law(laws[0]), replace(drops, **numbers)))
    for i, law in enumerate(laws):
        (one,) = np.array(drop_many(marcher.with_law(law), drops.part(i, i + 1))).T
        assert together[:, i].tolist() == one.tolist()
    assert np.ptp(together[0] / drops.height_m) > 0.02


def test_drops_that_touch_several_times(rng):
    """Stiff, hardly damped and far from upright."""
    body = beam_body(Bristle(material=Material(beta_s=1e-8)), 8)
    drops = leaning_drops(body, rng, 12, 20.0, kn_N_m=1e8)
    # rounding decides after how many of some fifty touches this one falls over
    drops = drops.chosen(np.arange(12) != 5)
    outcome = drop_many(marcher_of(body), drops)
    assert outcome.n_contacts.max() > 10
    # what rounding does to one touch grows with every other
    assert_the_same(body, drops, outcome, rel=1e-7)


def test_the_augmented_lagrangian(rng):
    body = beam_body(Bristle(material=Material(beta_s=1.07e-5)), 6)
    drops = leaning_drops(body, rng, 4, 3.0, kn_N_m=2e6)
    outcome = drop_many(marcher_of(body, Enforcement.AUGMENTED), drops)
    assert_the_same(body, drops, outcome, Enforcement.AUGMENTED, rel=1e-6)


def test_a_reduced_solid(make_solid, rng):
    solid = make_solid()
    shift = 4.0 / ITS**2
    body = reduce_solid(solid, shift, 12, leaning=True).modal
    drops = leaning_drops(body, rng, 4, 3.0)
    assert_the_same(body, drops, drop_many(marcher_of(body), drops))


@pytest.mark.parametrize("enforcement", [Enforcement.PENALTY, Enforcement.AUGMENTED])
def test_upright_drops_are_those_of_a_column(enforcement, rng):
    """All points alike are one point; leaning drops among them change nothing."""
    body = beam_body(Bristle(material=Material(beta_s=1e-8)), 8)
    assert symmetric_part(body, COLUMN) is not None
    tilt = np.where(np.arange(8) % 2, rng.uniform(1.0, 3.0, 8), 0.0)
    drops = leaning_drops(body, rng, 8, tilt_deg=tilt, tilt_wide_deg=0.0, kn_N_m=2e6)
    outcome = drop_many(marcher_of(body, enforcement), drops)
    rel = 1e-9 if enforcement is Enforcement.PENALTY else 1e-6
    # of crests of the ringing that are equal to nanometres, rounding chooses the highest
    assert_the_same(body, drops, outcome, enforcement, rel, tip_m=1e-8)


@pytest.mark.parametrize("plane", [0, 1], ids=["thin", "wide"])
@pytest.mark.parametrize("second_order", [False, True])
def test_drops_in_a_plane_of_symmetry_need_its_modes_alone(plane, second_order, rng):
    """Whether the bristle leans in it or the surface slopes in it; others among them do as ever."""
    body = beam_body(Bristle(), 8, second_order=second_order)
    part = symmetric_part(body, PLANES[plane])
    assert len(part.body.omega2) <= len(body.omega2) / 2
    assert len(part.points) ** 2 == len(body.contact.weights)
    tilts = {"tilt_deg": np.zeros(6), "tilt_wide_deg": np.zeros(6)}
    tilts[list(tilts)[plane]][:4] = rng.uniform(-3.0, 3.0, 4)
    drops = leaning_drops(body, rng, 6, kn_N_m=2e6, **tilts)
    slopes = [0.0, 0.0]
    slopes[plane] = 2.0
    drops.normals[4] = slope_normal(*slopes)
    place = body.contact.places_m[:, plane]
    drops.rises_m[4] = -drops.normals[4, :, plane] / drops.normals[4, :, 2] * place
    drops.tilt_wide_deg[5] = drops.tilt_deg[5] = 1.0
    assert drops.confined_to(part).tolist() == [True] * 5 + [False]
    rel = 1e-6 if second_order else 1e-9
    assert_the_same(body, drops, drop_many(marcher_of(body), drops), rel=rel, closure=np.inf)


def test_a_solid_has_neither_column_nor_plane(make_solid):
    body = reduce_solid(make_solid(), 4.0 / ITS**2, 12, leaning=True).modal
    assert [symmetric_part(body, axes) for axes in (COLUMN, *PLANES)] == [None] * 3


def test_outcomes_do_not_depend_on_what_else_is_dropped(rng):
    body = beam_body(Bristle(material=Material(beta_s=1.07e-5)), 6)
    drops = leaning_drops(body, rng, 9, tilt_deg=[0.0, 2.0, 0.0] * 3, tilt_wide_deg=0.0)
    together = drop_many(marcher_of(body), drops)
    parts = [drop_many(marcher_of(body), drops.part(i, i + 3)) for i in (0, 3, 6)]
    for whole, *pieces in zip(together, *parts, strict=True):
        assert np.array_equal(whole, np.concatenate(pieces))


def test_each_drop_takes_the_longest_step_that_serves(rng, monkeypatch):
    body = beam_body(Bristle(material=Material(beta_s=1.07e-5)), 6)
    drops, failing = leaning_drops(body, rng, 5), {1.0: [1, 3, 4], 0.5: [3, 4], 0.2: [4]}
    made, real = [], batch._dropped

    def dropped(marcher, some, **how):
        out, status = real(marcher, some, **how)
        part = round(marcher.its_s / ITS, 6)
        made.append((part, len(some)))
        status[np.isin(some.height_m, drops.height_m[failing[part]])] = modal_march.NOT_CONVERGED
        return out, status

    monkeypatch.setattr(batch, "_dropped", dropped)
    found = drop_each(lambda its: marcher_of(body, its=its), drops, ITS)
    monkeypatch.undo()
    assert made == [(1.0, 5), (0.5, 3), (0.2, 2)]
    for i, part in ((0, 1.0), (1, 0.5), (2, 1.0), (3, 0.2)):
        single = drop_many(marcher_of(body, its=part * ITS), drops.part(i, i + 1))
        assert found.rebound_height_m[i] == single.rebound_height_m[0]
    assert np.isnan(found.rebound_height_m[4])


def test_a_drop_that_stays_for_good_is_not_tried_again(rng):
    body = beam_body(Bristle(material=Material(beta_s=1.07e-5)), 6)
    drops = leaning_drops(body, rng, 2, tilt_deg=0.0, tilt_wide_deg=0.0, kn_N_m=2e6, mu=0.0)
    laws = [Adhesive(2e6, force) for force in (1.0, 1e3)]
    asked = []

    def marcher_at(its):
        asked.append(its)
        return marcher_of(body, its=its).with_law(laws[0])

    own = replace(drops, laws=np.array([law.parameters for law in laws]))
    found = drop_each(marcher_at, own, ITS)
    assert asked == [ITS]
    assert np.isfinite(found.rebound_height_m[0])
    assert np.isnan(found.rebound_height_m[1])


def test_a_bristle_that_slides_on_is_followed_only_where_a_drop_must_not_fail():
    """Where failures are let through, it would take most of the time and is no bounce."""
    body = beam_body(Bristle(material=Material(beta_s=1.07e-5)), 6, second_order=True)
    tilts = {"tilt_deg": np.array([1.0, 12.0]), "kn_N_m": 2e6}
    drops = Drops.on_plane(len(body.contact.weights), height_m=0.05, **tilts)
    many = drop_many(marcher_of(body), drops)
    touching = ITS * many.n_steps
    each = drop_each(lambda its: marcher_of(body, its=its), drops, ITS)
    assert touching[0] < LONGEST_S < touching[1]
    assert each.rebound_height_m[0] == many.rebound_height_m[0]
    assert np.isfinite(many.rebound_height_m[1])
    assert np.isnan(each.rebound_height_m[1])


def test_a_drop_that_comes_down_on_its_side_is_named(rng):
    """Alone, among many, and left out where failures are let through."""
    body = beam_body(Bristle(material=Material(beta_s=1.07e-5)), 6)
    drops = leaning_drops(body, rng, 3, tilt_deg=[2.0, 60.0, 1.0], tilt_wide_deg=0.0)
    drops.normals[1] = slope_normal(-40.0)
    with pytest.raises(ComputationError, match="drop 1: the bristle falls over"):
        drop_many(marcher_of(body), drops)
    with pytest.raises(ComputationError, match="comes down at 100 degrees"):
        alone(body, drops, 1)
    found = drop_each(lambda its: marcher_of(body, its=its), drops, ITS)
    assert np.isnan(found.rebound_height_m).tolist() == [False, True, False]


def test_a_law_that_makes_energy_fails_its_drop(rng, monkeypatch):
    body = beam_body(Bristle(material=Material(beta_s=1.07e-5)), 6)
    drops = leaning_drops(body, rng, 2, kn_N_m=2e6)
    law = HuntCrossley(2e6, 0.3)
    monkeypatch.setattr(HuntCrossley, "damping", property(lambda self: -1e-6 * self.damping_s_m))
    with pytest.raises(ComputationError, match="drop 0: .* gave energy"):
        drop_many(marcher_of(body).with_law(law), drops)


def test_a_drop_whose_energy_budget_does_not_close_fails():
    """Second order changes to linear flight at release: a weak bristle that leans far goes astray
    there."""
    weak = Material(youngs_Pa=1.5e9, poisson=0.42, density_kg_m3=910.0, beta_s=1.07e-5)
    body = beam_body(Bristle(material=weak), 6, second_order=True)
    tilts = {"tilt_deg": np.array([0.0, 8.0]), "kn_N_m": 2e6, "mu": 0.0}
    drops = Drops.on_plane(len(body.contact.weights), height_m=0.05, **tilts)
    with pytest.raises(ComputationError, match="drop 1: the energy budget is off"):
        drop_many(marcher_of(body), drops)
    found = drop_each(lambda its: marcher_of(body, its=its), drops, ITS)
    assert np.isnan(found.rebound_height_m).tolist() == [False, True]
    with pytest.raises(ComputationError, match="the motion went astray: an impact at"):
        alone(body, drops, 1)


def test_contact_that_opens_under_a_bent_bristle_is_found():
    """Anderson's acceleration alone does not find the steps in which this nylon lets go."""
    nylon = Material(youngs_Pa=2.1e9, poisson=0.34, density_kg_m3=1000.0, beta_s=1e-5)
    section = Rectangle(thickness_m=1.745e-4, width_m=4.473e-4)
    body = beam_body(Bristle(0.0957, section, nylon), 16, second_order=True)
    tilts = {"tilt_deg": np.linspace(4.25, 5.75, 4), "kn_N_m": 240.0, "mu": 0.0}
    drops = Drops.on_plane(len(body.contact.weights), height_m=0.0785, **tilts)
    found = drop_many(marcher_of(body, its=8.25e-6), drops)
    assert found.closure_relative.max() < 0.03


def test_a_drop_that_fails_is_named(rng):
    body = beam_body(Bristle(material=Material(beta_s=1.07e-5)), 6)
    drops = leaning_drops(body, rng, 4)
    drops.height_m[2] = np.nan
    with pytest.raises(ComputationError, match="drop 2: "):
        drop_many(marcher_of(body), drops)
