"""The effects by name.

A new effect needs a class in one of these files and a test; those of users come from `outside`.
"""

from __future__ import annotations

from collections.abc import Iterable
from types import ModuleType

from ..contact.laws import Linear
from ..errors import InputError
from . import body, contact, observation, release, surface
from .base import Effect, Place, Scene


def effects_in(module: ModuleType) -> list[type[Effect]]:
    """The effects defined in a module, in order."""
    return [
        each
        for each in vars(module).values()
        if isinstance(each, type) and issubclass(each, Effect)
        if each.__module__ == module.__name__
    ]


EFFECTS: dict[str, type[Effect]] = {
    each.name: each
    for module in (release, observation, contact, body, surface)
    for each in effects_in(module)
}


def enter_all(scene: Scene, effects: Iterable[Effect]) -> Scene:
    """The scene with all ``effects`` applied, in any order."""
    by_name = {effect.name: effect for effect in effects}
    for name in in_order(by_name):
        before, scene = scene, by_name[name].enter(scene)
        if type(before.law) is not Linear and type(scene.law) is not type(before.law):
            raise InputError(
                f"{name} replaces the contact law of another; take one", inputs=("effects",)
            )
    return scene


def in_order(names: Iterable[str]) -> list[str]:
    """Effects in the order in which they enter a scene.

    Effects on Kn come before the contact law it belongs to. Effects from outside come before this
    program's laws, which refuse to replace another.
    """
    known = list(EFFECTS)

    def place(name: str) -> tuple[bool, bool, int]:
        kind = EFFECTS[name]
        stiffness = kind.computed and kind.place is Place.SURFACE
        return not stiffness, not kind.origin, known.index(name)

    return sorted(names, key=place)
