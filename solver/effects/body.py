"""Effects in the bristle's material: damping and lateral inertia."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .. import paper
from .base import TOUCHING, Effect, Parameter, Place, Scene

BOUNCING = TOUCHING | {"waves"}


@dataclass(frozen=True)
class MaterialDamping(Effect):
    """The stiffness-proportional damping differs from the declared one."""

    beta_s: float = 1e-8

    name = "material_damping"
    title = "another material damping"
    place = Place.BODY
    kinds = BOUNCING
    source = "Rayleigh; the paper's β comes from slow bending, wave records of bars are near 1e-8 s"
    parameters = (
        Parameter(
            "beta_s",
            "s",
            1e-9,
            1e-4,
            1e-8,
            null=paper.BETA_S,
            logarithmic=True,
            why="from wave records of metal bars to ten times the paper's",
        ),
    )

    def enter(self, scene: Scene) -> Scene:
        return replace(scene, beta_s=self.beta_s)


@dataclass(frozen=True)
class HystereticDamping(Effect):
    """A loss per cycle independent of frequency, as in metals and joints.

    Every elastic mode gets the viscous damping η ω, equal to a loss factor η at its frequency.
    """

    loss_factor: float = 0.01

    name = "hysteretic_damping"
    title = "loss per cycle independent of frequency"
    place = Place.BODY
    kinds = BOUNCING
    source = "Crandall, J. Sound Vib. 11 (1970); loss factors of metals 1e-4 to 1e-2, joints 0.1"
    parameters = (Parameter("loss_factor", "", 0.0, 0.5, 0.01, why="from metals to lossy joints"),)

    def enter(self, scene: Scene) -> Scene:
        return replace(scene, loss_factor=scene.loss_factor + self.loss_factor)


@dataclass(frozen=True)
class LateralInertia(Effect):
    """A compressed bar bulges, and its sides have inertia: Love's correction.

    ``strength`` multiplies Love's ρ ν² I_p; a solid includes it.
    """

    strength: float = 1.0

    name = "lateral_inertia"
    title = "inertia of the bulging section"
    place = Place.BODY
    kinds = frozenset({"waves"})
    source = "Love, Mathematical Theory of Elasticity (1892), § 278; Graff, Wave Motion (1975)"
    parameters = (Parameter("strength", "", 0.0, 2.0, 1.0, why="1 is Love's"),)

    def enter(self, scene: Scene) -> Scene:
        return replace(scene, lateral_inertia=scene.lateral_inertia + self.strength)
