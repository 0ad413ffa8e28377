"""The effects by name.

Adding one takes a class with its test, and a line here; those of users come by `outside`.
"""

from __future__ import annotations

from collections.abc import Iterable

from ..contact.laws import Linear
from ..errors import InputError
from .base import Effect, Place, Scene
from .body import HystereticDamping, LateralInertia, MaterialDamping
from .contact import (
    Adhesion,
    ContactDamping,
    HuntCrossleyContact,
    PlasticContact,
    StiffeningContact,
)
from .observation import ClockError, HeightOffset, ScaleError
from .release import AirDrag, ReleaseVelocity
from .surface import BristleTilt, SurfacePhases, SurfaceSlope, Wear

EFFECTS: dict[str, type[Effect]] = {
    each.name: each
    for each in (
        AirDrag,
        ReleaseVelocity,
        HeightOffset,
        ScaleError,
        ClockError,
        ContactDamping,
        HuntCrossleyContact,
        StiffeningContact,
        PlasticContact,
        Adhesion,
        MaterialDamping,
        HystereticDamping,
        LateralInertia,
        BristleTilt,
        SurfaceSlope,
        SurfacePhases,
        Wear,
    )
}


def enter_all(scene: Scene, effects: Iterable[Effect]) -> Scene:
    """The scene with all ``effects`` in it, whatever their order."""
    by_name = {effect.name: effect for effect in effects}
    for name in in_order(by_name):
        before, scene = scene, by_name[name].enter(scene)
        if type(before.law) is not Linear and type(scene.law) is not type(before.law):
            raise InputError(f"--effect: {name} replaces the contact law of another; take one")
    return scene


def in_order(names: Iterable[str]) -> list[str]:
    """Effects in the order in which they enter a scene.

    What changes Kn goes before the law that it belongs to; what comes from outside goes before the
    laws of this program, which refuse to replace another.
    """
    known = list(EFFECTS)

    def place(name: str) -> tuple[bool, bool, int]:
        kind = EFFECTS[name]
        stiffness = kind.computed and kind.place is Place.SURFACE
        return not stiffness, not kind.origin, known.index(name)

    return sorted(names, key=place)
