"""An effect of one's own: contact whose stiffness depends on the speed of impact.

    bristle drop --plugin my_effect.py --effect my_effect:exponent=-0.5
    bristle synth --plugin my_effect.py --effect my_effect:exponent=-0.5 --out mystery
    bristle close-loop --plugin my_effect.py mystery

Kn (v / v0)^exponent, with v0 the speed after a fall of 50 mm: above zero a contact that stiffens
with the rate of loading, below zero one that gives way.
"""

from dataclasses import dataclass, replace

from bristle.solver.effects.base import Effect, Parameter, Place, Scene

REFERENCE_M = 0.05


@dataclass(frozen=True)
class MyEffect(Effect):
    """Kn in proportion to a power of the speed of impact, v² = 2 g y0 (Eq. 1)."""

    exponent: float = -0.5

    name = "my_effect"
    title = "contact stiffness that depends on speed"
    place = Place.CONTACT
    kinds = frozenset({"drops", "tracks", "forces"})
    source = "an example"
    parameters = (Parameter("exponent", "", -2.0, 2.0, -0.5, why="as much as anybody would see"),)

    def enter(self, scene: Scene) -> Scene:
        faster = (scene.height_m / REFERENCE_M) ** 0.5
        kn_N_m = scene.law.kn_N_m * faster**self.exponent
        return replace(scene, law=replace(scene.law, kn_N_m=kn_N_m))
