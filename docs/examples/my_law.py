"""A contact law of one's own: a soft film over the ground, which is pressed away before it holds.

    bristle drop --plugin my_law.py --effect my_law:film_m=5e-6
    bristle synth --plugin my_law.py --effect my_law:film_m=5e-6 --out mystery
    bristle close-loop --plugin my_law.py mystery

Any force that increases with penetration and gives back what it took can stand in its place, also
one that was measured: ``Tabulated(kn_N_m, penetration_m, force_over_kn_m)`` takes its points.
"""

from dataclasses import dataclass, replace

import numpy as np

from bristle.solver.contact.laws import Tabulated
from bristle.solver.effects.base import Effect, Parameter, Place, Scene

# Deeper than drops press; beyond it the force goes straight on.
REACH_M = 2e-4


@dataclass(frozen=True)
class MyLaw(Effect):
    """Force = Kn (δ - d (1 - exp(-δ/d))): no stiffness at first touch, Kn beyond the film d."""

    film_m: float = 5e-6

    name = "my_law"
    title = "a soft film over the ground"
    place = Place.CONTACT
    kinds = frozenset({"drops", "tracks", "forces"})
    source = "an example"
    parameters = (Parameter("film_m", "m", 0.0, 2e-5, 5e-6, why="as deep as the bristle presses"),)

    def enter(self, scene: Scene) -> Scene:
        film_m = self.film_m
        if film_m == 0.0:
            return scene

        def force_over_kn(depth_m: np.ndarray) -> np.ndarray:
            return depth_m + film_m * np.expm1(-depth_m / film_m)

        return replace(scene, law=Tabulated.of(scene.law.kn_N_m, force_over_kn, REACH_M))
