"""Effects in the contact law: force not proportional to penetration."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..contact import laws
from ..errors import InputError
from .base import TOUCHING, Effect, Parameter, Place, Scene


def _with_law(scene: Scene, law: laws.ContactLaw) -> Scene:
    """The scene with ``law``; InputError if an effect has set one already: contact has one law."""
    if type(scene.law) is not laws.Linear:
        raise InputError(
            "two of the effects change the contact law; take one of them", inputs=("effects",)
        )
    return replace(scene, law=law)


@dataclass(frozen=True)
class ContactDamping(Effect):
    """A dashpot in parallel with the contact's spring."""

    c_N_s_m: float = 5.0

    name = "contact_damping"
    title = "dashpot in the contact"
    place = Place.CONTACT
    kinds = TOUCHING
    source = "Kelvin and Voigt's model"
    parameters = (
        Parameter(
            "c_N_s_m",
            "N s/m",
            0.0,
            40.0,
            5.0,
            why="up to the wave impedance of the bristle, 42 N s/m: more of it takes less",
        ),
    )

    def enter(self, scene: Scene) -> Scene:
        return _with_law(scene, laws.Damped(scene.law.kn_N_m, self.c_N_s_m))


@dataclass(frozen=True)
class HuntCrossleyContact(Effect):
    """Damping that grows with penetration: the force starts and ends at zero."""

    damping_s_m: float = 0.3

    name = "hunt_crossley"
    title = "contact damping that grows with penetration"
    place = Place.CONTACT
    kinds = TOUCHING
    source = "Hunt and Crossley, J. Appl. Mech. 42 (1975)"
    parameters = (
        Parameter("damping_s_m", "s/m", 0.0, 3.0, 0.3, why="restitution is about 1 - ⅔ λ v"),
    )

    def enter(self, scene: Scene) -> Scene:
        return _with_law(scene, laws.HuntCrossley(scene.law.kn_N_m, self.damping_s_m))


@dataclass(frozen=True)
class StiffeningContact(Effect):
    """Force that grows faster than penetration: asperities that flatten, or Hertz's 3/2.

    The force is Kn δ at a penetration of 20 µm.
    """

    exponent: float = 1.5

    name = "stiffening_contact"
    title = "contact that stiffens"
    place = Place.CONTACT
    kinds = TOUCHING
    source = "Hertz (1882): 3/2; Greenwood and Williamson (1966): higher for rough surfaces"
    parameters = (Parameter("exponent", "", 1.0, 3.0, 1.5, null=1.0, why="Hertz's is 1.5"),)

    def enter(self, scene: Scene) -> Scene:
        return _with_law(scene, laws.Stiffening(scene.law.kn_N_m, self.exponent))


@dataclass(frozen=True)
class PlasticContact(Effect):
    """The surface yields: the force stops growing, or grows less, and an indentation remains."""

    yield_N: float = 20.0
    hardening: float = 0.0
    unloading: float = 1.0

    name = "plastic_contact"
    title = "contact that yields"
    place = Place.CONTACT
    kinds = TOUCHING
    source = "Johnson, Contact Mechanics (1985), ch. 11; Walton and Braun, J. Rheol. 30 (1986)"
    parameters = (
        Parameter(
            "yield_N",
            "N",
            5.0,
            200.0,
            20.0,
            null=200.0,
            logarithmic=True,
            why="from an eighth of the paper's impact force, 41 N, to five times it",
        ),
        Parameter(
            "hardening",
            "of Kn",
            0.0,
            0.3,
            0.0,
            why="stiffness beyond yield: metals and crushed stone have some hundredths",
            refines=True,
        ),
        Parameter(
            "unloading",
            "of Kn",
            1.0,
            10.0,
            1.0,
            null=1.0,
            logarithmic=True,
            why="stiffness on the way back, over the flatter place that flow has left",
            refines=True,
        ),
    )

    def enter(self, scene: Scene) -> Scene:
        law = laws.Plastic(scene.law.kn_N_m, self.yield_N, self.hardening, self.unloading)
        return _with_law(scene, law)


@dataclass(frozen=True)
class Adhesion(Effect):
    """A tip that has touched sticks until it is pulled off."""

    pull_off_N: float = 5.0

    name = "adhesion"
    title = "adhesion"
    place = Place.CONTACT
    kinds = TOUCHING
    source = "Johnson, Kendall and Roberts, Proc. R. Soc. A 324 (1971): a pull-off force"
    parameters = (
        Parameter(
            "pull_off_N", "N", 0.0, 20.0, 5.0, why="up to half of what the impact pushes with"
        ),
    )

    def enter(self, scene: Scene) -> Scene:
        return _with_law(scene, laws.Adhesive(scene.law.kn_N_m, self.pull_off_N))
