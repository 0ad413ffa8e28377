"""The effects by name.

Adding one takes a class with its test, and a line here.
"""

from __future__ import annotations

from collections.abc import Iterable

from .base import Effect, Scene
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
# What changes Kn goes before the law that it belongs to, chance before what it acts on.
_ORDER = {name: number for number, name in enumerate(EFFECTS)}
_FIRST = ("surface_phases", "wear")


def enter_all(scene: Scene, effects: Iterable[Effect]) -> Scene:
    """The scene with all ``effects`` in it, whatever their order."""
    for effect in sorted(effects, key=lambda each: (each.name not in _FIRST, _ORDER[each.name])):
        scene = effect.enter(scene)
    return scene
