"""A contact law of one's own with a memory: it yields, and hardens as it flows.

    bristle drop --plugin my_plastic_law.py --effect my_plastic_law:yield_N=20
    bristle synth --plugin my_plastic_law.py --effect my_plastic_law:yield_N=20 --out mystery
    bristle close-loop --plugin my_plastic_law.py mystery

A law is a dataclass of its numbers, Kn first, and the `Kind` that computes with them at one point:
functions that Numba compiles. Their ``law`` has the numbers in the order of the fields, ``scale``
is the point's own stiffness over the law's, and the last argument is what the point remembers from
step to step, zero where it was not touched before; here, how deep it is indented for good.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

from numba import njit

from bristle.solver.contact.laws import ContactLaw
from bristle.solver.contact.points import Kind
from bristle.solver.effects.base import Effect, Parameter, Place, Scene


@njit
def elastic(law, scale, approach, compliance, indented):
    """Force in N, tangent in N/m and potential in J: Kn up to yield, a share of Kn beyond."""
    kn, most, share = scale * law[0], law[1], law[2]
    depth = approach - indented
    if depth <= 0.0:
        return 0.0, 0.0, 0.0
    # what has flowed before has raised the force at which it yields
    most += kn * share / (1.0 - share) * indented
    over = depth - most / kn
    if over <= 0.0:
        return kn * depth, kn, 0.5 * kn * depth * depth
    stored = 0.5 * most * most / kn
    return most + share * kn * over, share * kn, stored + over * (most + 0.5 * share * kn * over)


def remembered(law, scale, approach, indented):
    """The indentation in m after a step that ends at the approach."""
    force = elastic(law, scale, approach, 0.0, indented)[0]
    return max(indented, approach - force / (scale * law[0]))


def clear_at(law, scale, indented):
    """The approach at which a point that leaves its indentation has no force any more."""
    return indented


@dataclass(frozen=True)
class Hardening(ContactLaw):
    """Elastic with Kn up to ``yield_N``, then with a share of it; unloads with Kn."""

    kn_N_m: float
    yield_N: float
    hardening: float

    kind: ClassVar[Kind] = Kind.of(elastic, remembered, clear_at)


@dataclass(frozen=True)
class MyPlasticLaw(Effect):
    """The contact yields, and hardens by a tenth of its stiffness."""

    yield_N: float = 20.0

    name = "my_plastic_law"
    title = "contact that yields and hardens"
    place = Place.CONTACT
    kinds = frozenset({"drops", "tracks", "forces"})
    source = "an example"
    parameters = (
        Parameter(
            *("yield_N", "N", 5.0, 200.0, 20.0),
            null=200.0,
            logarithmic=True,
            why="up to five times the force of an impact",
        ),
    )

    def enter(self, scene: Scene) -> Scene:
        if self.yield_N == 200.0:
            return scene
        return replace(scene, law=Hardening(scene.law.kn_N_m, self.yield_N, 0.1))
