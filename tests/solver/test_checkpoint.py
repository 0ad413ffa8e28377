"""A march interrupted anywhere goes on to the bit; foreign marks are refused."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from bristle.solver.bodies.beam import beam_body
from bristle.solver.bodies.floating import FloatingModel
from bristle.solver.bodies.reduced import reduce_solid
from bristle.solver.bristle import Bristle, Material
from bristle.solver.checkpoint import Checkpoint
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import Adhesive, Coulomb, Damped, Linear, Plastic
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.errors import ComputationError, InputError
from bristle.solver.time.finite import FiniteMarcher
from bristle.solver.time.march import Marcher
from bristle.solver.time.scheme import TimeScheme

G, KN, ITS = 9.8, 2e6, 1e-5
MADE_FOR = {"--kn": "2000000.0", "mesh": "one"}
METHODS = [
    ContactMethod(Linear(KN), friction=Coulomb(0.3)),
    ContactMethod(Linear(KN), Enforcement.AUGMENTED, friction=Coulomb(0.3)),
    ContactMethod(Linear(KN), Enforcement.NITSCHE),
    ContactMethod(Damped(KN, 3.0)),
    ContactMethod(Plastic(KN, 20.0)),
    ContactMethod(Adhesive(KN, 3.0)),
]


class Interrupted(Exception):
    pass


class Seer:
    """An observer that notes what it sees, and stops the run at a step."""

    def __init__(self, stop=None):
        self.seen, self.stop = [], stop

    def __call__(self, state, force):
        if self.stop is not None and len(self.seen) >= self.stop:
            raise Interrupted
        self.seen.append((state.t_s, float(np.abs(state.u).sum()), float(force.sum())))

    def memory(self):
        return {"seen": np.array(self.seen)}

    def recall(self, mark, state):
        self.seen = [tuple(row) for row in mark.arrays["observer.seen"]]


@pytest.fixture
def folder(tmp_path):
    return MPI.COMM_WORLD.bcast(tmp_path) / "checkpoint"


def eager(folder, comm=MPI.COMM_WORLD, made_for=MADE_FOR, **options):
    """A checkpoint that makes a mark at each look at its clock."""
    return Checkpoint(folder, comm, made_for, every_s=0.0, **options)


def frame(points=3):
    return ModalFrame(beam_body(Bristle(material=Material(beta_s=1e-7)), 6, points=points))


def plan_of(method, **changes):
    plan = DropPlan(0.01, method, ITS, G, tilt_deg=2.0, tilt_wide_deg=1.0)
    return replace(plan, **changes)


def the_same(one, two):
    """Whether two results are equal to the last bit."""
    for name, value in vars(one).items():
        other = getattr(two, name)
        if name == "history":
            assert np.array_equal(value.array(), other.array())
        else:
            assert value == other, name


def assert_it_goes_on_to_the_bit(body, plan, share, folder, marcher=lambda: None):
    """Where a drop is interrupted after so large a ``share`` of what is seen of it."""
    whole, again = Seer(), Seer()
    uninterrupted = simulate(body, plan, marcher(), whole)
    stop = int(share * len(whole.seen))
    with pytest.raises(Interrupted):
        simulate(body, plan, marcher(), Seer(stop), eager(folder))
    the_same(simulate(body, plan, marcher(), again, eager(folder, resume=True)), uninterrupted)
    assert again.seen == whole.seen


@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("share", [0.02, 0.4, 0.97])
def test_a_drop_goes_on_to_the_bit(method, share, folder):
    assert_it_goes_on_to_the_bit(frame(), plan_of(method), share, folder)


def test_a_march_that_begins_elsewhere_is_refused(folder):
    body, plan = frame(), plan_of(METHODS[0])
    with pytest.raises(Interrupted):
        simulate(body, plan, observer=Seer(20), checkpoint=eager(folder))
    higher = replace(plan, height_m=1.001 * plan.height_m)
    with pytest.raises(InputError, match="a march that began elsewhere"):
        simulate(body, higher, None, Seer(), eager(folder, resume=True))
    # what another machine's rounding makes of it is let through
    rounded = replace(plan, height_m=(1.0 + 1e-12) * plan.height_m)
    simulate(body, rounded, None, Seer(), eager(folder, resume=True))


def test_every_touch_of_a_drop_goes_on(folder):
    """Interrupted again and again, each time a little later than where it had come to."""
    body = frame(2)
    plan = plan_of(ContactMethod(Linear(1e8)), its_s=1e-6, until_s=0.12)
    whole = Seer()
    uninterrupted = simulate(body, plan, observer=whole)
    resume, stop = False, len(whole.seen) // 5
    while True:
        seer = Seer(stop)
        try:
            result = simulate(body, plan, None, seer, eager(folder, resume=resume))
            break
        except Interrupted:
            assert seer.seen == whole.seen[: len(seer.seen)]
            resume, stop = True, stop + len(whole.seen) // 5
    the_same(result, uninterrupted)
    assert seer.seen == whole.seen
    assert len({path.name.split("-")[1] for path in folder.glob("march-*")}) > 1


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_the_solid_at_full_order_goes_on_to_the_bit(make_solid, folder, strain):
    """On as many ranks as there are."""
    solid = make_solid(cells=(1, 1, 12), order=1)
    body = reduce_solid(solid, 4.0 / ITS**2, 12, leaning=True)
    plan = DropPlan(0.01, ContactMethod(Linear(KN), friction=Coulomb(0.3)), 1e-6, G, tilt_deg=1.0)
    kind = Marcher
    if strain == "finite":
        body, kind = FloatingModel(**vars(body)), FiniteMarcher

    def marcher():
        return kind(solid, plan.method, TimeScheme.average(), plan.its_s, G)

    assert_it_goes_on_to_the_bit(body, plan, 0.5, folder, marcher)


# --- files ----------------------------------------------------------------------------------------


def two_marks(folder, made_for=MADE_FOR):
    """Marks of two marches, the second not done, and what they hold."""
    kept = eager(folder, made_for=made_for)
    arrays = {"x": np.arange(6.0).reshape(2, 3), "n": np.array(3)}
    for march, done in ((0, True), (1, False)):
        assert kept.begin() is None
        kept.keep_frame({"u": np.full(2, float(march))})
        kept.save(10 * march + 5, arrays, done=done)
    return arrays


def test_marks_come_back_with_their_frames(folder):
    arrays = two_marks(folder)
    again = eager(folder, resume=True)
    for march, done in ((0, True), (1, False)):
        mark = again.begin()
        assert (mark.steps, mark.done) == (10 * march + 5, done)
        assert mark.arrays.keys() == arrays.keys()
        assert all(np.array_equal(mark.arrays[name], arrays[name]) for name in arrays)
        assert [frame["u"][0] for frame in mark.frames] == [float(march)]
    assert again.begin() is None


@pytest.mark.parametrize("look", [1, 3])
def test_the_clock_is_looked_at_as_often_as_asked_for(folder, look):
    kept = eager(folder, look=look)
    assert [kept.due() for _ in range(6)] == [(i + 1) % look == 0 for i in range(6)]


def test_without_resume_an_earlier_run_is_forgotten(folder):
    two_marks(folder)
    assert eager(folder).begin() is None
    assert not folder.exists()


@pytest.mark.parametrize(
    ("made_for", "named"),
    [
        ({**MADE_FOR, "--kn": "3e6"}, "--kn"),
        ({**MADE_FOR, "mesh": "another"}, "mesh"),
        ({**MADE_FOR, "--tilt": "1.0"}, "--tilt"),
        ({"mesh": "one"}, "--kn"),
    ],
    ids=str,
)
def test_marks_of_another_run_are_refused_by_name(folder, made_for, named):
    two_marks(folder)
    with pytest.raises(InputError, match=f"was kept for another {named}; remove it"):
        eager(folder, made_for=made_for, resume=True)


@pytest.mark.serial
def test_marks_of_other_ranks_are_refused(folder):
    kept = eager(folder)
    kept._made_for["number of ranks"] = "2"
    kept.begin()
    kept.save(5, {"x": np.zeros(3)})
    with pytest.raises(InputError, match="another number of ranks"):
        eager(folder, resume=True)


@pytest.mark.serial
@pytest.mark.parametrize("how", ["cut", "changed", "emptied", "pickled"])
def test_a_damaged_mark_counts_for_nothing(folder, how):
    two_marks(folder)
    path = folder / "march-1-15-0.npz"
    content = path.read_bytes()
    if how == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif how == "emptied":
        path.write_bytes(b"")
    else:
        with np.load(path) as file:
            arrays = dict(file)
        arrays["x"] = arrays["x"] + 1e-9 if how == "changed" else np.array([print], dtype=object)
        np.savez(path, **arrays)
    again = eager(folder, resume=True)
    assert again.begin().done
    assert again.begin() is None


@pytest.mark.serial
def test_a_disk_that_is_full_ends_the_run_with_a_word(folder, monkeypatch):
    kept = eager(folder)
    kept.begin()

    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(ComputationError, match="kept in .*checkpoint: No space left on device"):
        kept.save(1, {"x": np.zeros(3)})
    assert not list(folder.iterdir())
