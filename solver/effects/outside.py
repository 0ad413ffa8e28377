"""Effects from outside: classes in a user's file, or in installed packages.

A package names its classes under the entry point `ENTRY_POINT`. Each is checked first. If accepted,
beam, reduced solid, solid and the loop use it; otherwise it is refused with the reason.
"""

from __future__ import annotations

import hashlib
import logging
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from importlib.metadata import entry_points
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from .. import paper
from ..arrays import Array
from ..contact.laws import ContactLaw, Damped, Linear, check_compiled
from ..errors import InputError
from .base import TOUCHING, Effect, Parameter, Place, Scene
from .library import EFFECTS, effects_in

ENTRY_POINT = "bristle.effects"
# Fields of a scene that a simulated drop uses, and those that the loop uses for drops that it
# computes from drops without effects.
SIMULATED_FIELDS = {"law", "beta_s", "loss_factor"}
COMPUTED_FIELDS = {
    *("release_speed_m_s", "drag_kg_m", "law"),
    *("y_offset_m", "y_scale", "t_scale"),
}
# Fields that a drop takes from its own inputs, whatever an effect does to them.
IGNORED = ("height_m", "order", "session", "chance", "front_m2")
# Drops on which effects are tested.
LOW = Scene(height_m=0.01, beta_s=paper.BETA_S, loss_factor=1e-3, lateral_inertia=1.0)
HIGH = replace(LOW, height_m=0.05)
LATER: tuple[dict[str, Any], ...] = ({"order": 7}, {"chance": (-1.0, 2.0)})
PLAIN = (LOW, HIGH, *(replace(LOW, **late) for late in LATER))
# Names of the effects of installed packages.
INSTALLED: set[str] = set()
# Prefix of the names of users' modules, before the start of their digest.
MODULE = "bristle_plugin_"
MOST_PARAMETERS = 2
# Penetrations at which a contact law is tested: several times those of drops.
DEEPEST_M, DEPTHS = 1e-4, 1001


@contextmanager
def forgotten_afterwards() -> Iterator[None]:
    """Effects registered in the block are unregistered after it, except those of installed
    packages."""
    before = set(EFFECTS)
    try:
        yield
    finally:
        for name in EFFECTS.keys() - before - INSTALLED:
            del EFFECTS[name]


def load(path: Path, source: bytes) -> ModuleType:
    """Import a Python file and register its effects; ValueError if it fails or one is refused."""
    digest, path = hashlib.sha256(source).hexdigest(), path.resolve()
    module = f"{MODULE}{digest[:16]}"
    found = sys.modules.get(module) or _executed(source, path, module)
    for each in effects_in(found):
        try:
            register(each, digest)
        except InputError as error:
            raise ValueError(f"{path}: {error}") from None
    return found


def _executed(source: bytes, path: Path, name: str) -> ModuleType:
    """The module ``name`` of this source, executed from the text; it leaves no file behind."""
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module  # dataclasses need their module there
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise ValueError(f"{path}: {type(error).__name__}: {error}") from error
    return module


@lru_cache(maxsize=1)
def load_installed() -> None:
    """Register the effects of installed packages; one that is refused is skipped with a warning."""
    for point in entry_points(group=ENTRY_POINT):
        try:
            kind = point.load()
            package = point.dist
            register(kind, f"{point.value} {package.version if package else ''}")
            INSTALLED.add(kind.name)
        except Exception as error:
            logging.getLogger("bristle").warning(
                "the effect %s of an installed package is left out: %s", point.name, error
            )


def taken_in(effect: Effect) -> Effect:
    """An effect made in Python, its class registered; InputError if the class is refused."""
    kind = type(effect)
    if EFFECTS.get(kind.name) is not kind:
        register(kind, f"{kind.__module__}.{kind.__qualname__} {id(kind)}")
    return effect


def register(kind: type[Effect], origin: str) -> None:
    """Register an effect; ``origin`` names its source. InputError says what is wrong."""
    name = getattr(kind, "name", None)
    there = EFFECTS.get(str(name))
    if there is not None and there.origin == origin and origin:
        return
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise InputError(f"{kind.__name__}: its name must be of small letters, digits and _")
    if there is not None:
        raise InputError(f"{name}: there is an effect of this name already")
    problem = _problem(kind)
    if problem:
        raise InputError(f"{name}: {problem}")
    kind.origin = origin
    EFFECTS[name] = kind


def _problem(kind: type[Effect]) -> str:
    """What is wrong with an effect, or an empty string."""
    parameters = getattr(kind, "parameters", ())
    if not is_dataclass(kind) or not all(isinstance(each, Parameter) for each in parameters):
        return "must be a dataclass, and its parameters a tuple of Parameter"
    names = [each.name for each in parameters]
    if not names or names != [each.name for each in fields(kind)]:
        return f"its fields must be its parameters, in their order: {', '.join(names)}"
    for word in ("title", "source"):
        if not getattr(kind, word, ""):
            return f"has no {word}"
    if not isinstance(getattr(kind, "place", None), Place):
        return "its place must be one of Place"
    if not set(getattr(kind, "kinds", ())) <= TOUCHING:
        return f"its kinds may be {', '.join(sorted(TOUCHING))}: other data take no effects so"
    for each in parameters:
        if not (each.low <= each.null <= each.high and each.low <= each.typical <= each.high):
            return f"{each.name}: absence and typical size must lie within the bounds"
        if each.logarithmic and each.low <= 0.0:
            return f"{each.name}: what counts by its logarithm must be positive"
    return _acts(kind)


def _acts(kind: type[Effect]) -> str:
    """What is wrong with an effect's action on test drops, or an empty string."""
    sizes = {
        "typical": {each.name: each.typical for each in kind.parameters},
        "absent": {each.name: each.null for each in kind.parameters},
    }
    for each in kind.parameters:
        sizes[f"least {each.name}"] = {**sizes["typical"], each.name: each.low}
        sizes[f"greatest {each.name}"] = {**sizes["typical"], each.name: each.high}
    done: dict[str, list[Scene]] = {}
    for size, values in sizes.items():
        try:
            done[size] = [kind(**values).enter(scene) for scene in PLAIN]
        except Exception as error:
            return f"fails where it is {size}: {type(error).__name__}: {error}"
        if not all(isinstance(scene, Scene) for scene in done[size]):
            return "enter must return a Scene"
        for scene in done[size]:
            problem = _wrong_law(scene.law)
            if problem:
                return f"where it is {size}, its contact law {problem}"
    changed = {size: _changed(PLAIN, scenes) for size, scenes in done.items()}
    ignored = sorted(changed["typical"] & set(IGNORED))
    if ignored:
        return f"changes {', '.join(ignored)}, which a drop does not take from effects"
    if not changed["typical"]:
        return "changes nothing at its typical size"
    for each in kind.parameters:
        if done[f"least {each.name}"] == done[f"greatest {each.name}"]:
            return f"{each.name} changes nothing"
    return _predictable(kind, changed, done) if kind.kinds else ""


def _wrong_law(law: ContactLaw) -> str:
    """What is wrong with a contact law, tested at one point, or an empty string."""
    if type(law) in (Linear, Damped):
        return ""
    depth = np.linspace(0.0, DEEPEST_M, DEPTHS)
    try:
        check_compiled(law)
        force, tangent = law.force(depth, 0.0), law.tangent(depth, 0.0)
        stored, before = law.potential(depth, 0.0), law.force(-depth, 0.0)
        for name in ("remembered", "clear_at"):
            getattr(law.kind, name).__wrapper_address__()  # compiles
        own = law.kind.remembered
        memory = [own.function(law.parameters, 1.0, float(each), 0.0) for each in depth]
        after = law.force(depth, 0.0, 1.0, np.array(memory))
    except Exception as error:
        why = "; ".join(str(error).splitlines()[:2])
        return f"fails: {type(error).__name__}: {why}"
    if not np.isfinite([force, tangent, stored, after]).all():
        return "is not finite"
    if before.any() or force[0] != 0.0 or stored[0] != 0.0:
        return "has a force or a potential before it is touched"
    if not _integrates(force, tangent, depth) or not _integrates(stored, force, depth):
        return "has a tangent that is not the slope of its force, or a force not of its potential"
    if not np.allclose(after, force, rtol=1e-6, atol=1e-9 * np.abs(force).max()):
        return "has another force once what a step leaves is remembered"
    return ""


def _integrates(whole: Array, slope: Array, x: Array) -> bool:
    """Whether ``whole`` is the integral of ``slope`` from zero on, within what these points
    resolve: the error of a trapezoid is half the change of slope over it, wherever that occurs."""
    steps = np.diff(x)
    sums = np.cumsum(0.5 * (slope[1:] + slope[:-1]) * steps)
    unsure = np.cumsum(0.5 * np.abs(np.diff(slope)) * steps)
    return bool((np.abs(whole[1:] - sums) <= 1e-6 * np.abs(whole).max() + unsure).all())


def _changed(before: Sequence[Scene], after: Sequence[Scene]) -> set[str]:
    """The fields in which scenes differ."""
    return {
        each.name
        for one, other in zip(before, after, strict=True)
        for each in fields(Scene)
        if getattr(one, each.name) != getattr(other, each.name)
    }


def _predictable(
    kind: type[Effect], changed: Mapping[str, set[str]], done: Mapping[str, Sequence[Scene]]
) -> str:
    """Why the loop could not predict an effect, or an empty string."""
    if len(kind.parameters) > MOST_PARAMETERS:
        return f"the loop takes at most {MOST_PARAMETERS} parameters"
    if any(each.refines for each in kind.parameters):
        return "the loop refines its own effects alone: no parameter may have refines = True"
    if changed["absent"]:
        return "changes drops where its parameters are those of its absence"
    allowed = COMPUTED_FIELDS if kind.computed else SIMULATED_FIELDS
    other = sorted(changed["typical"] - allowed)
    if other:
        instead = f"computed = {not kind.computed} is for these"
        if not set(other) <= COMPUTED_FIELDS | SIMULATED_FIELDS:
            instead = "the loop takes these from its own effects alone"
        return f"changes {', '.join(other)}: {instead}; or give it no kinds, for simulations only"
    if kind.computed:
        return _of_arrays(kind, done["typical"])
    low, _, *later = done["typical"]
    again = (replace(low, **late) for late in LATER)
    if kind.random or any(one != other for one, other in zip(again, later, strict=True)):
        return "differs from drop to drop, which only computed effects may"
    return ""


def _of_arrays(kind: type[Effect], alone: Sequence[Scene]) -> str:
    """Why `enter` does not give the same for many drops at once as for each, or an empty string."""
    every: dict[str, Any] = {
        "height_m": np.array([scene.height_m for scene in PLAIN]),
        "order": np.array([scene.order for scene in PLAIN]),
        "chance": (np.array([scene.chance[0] for scene in PLAIN]), 0.0),
    }
    if not all(type(scene.law) is Linear for scene in alone):
        return "is computed, and may change no more of the contact law than its stiffness"
    try:
        values = (each.typical + 0.0 * every["height_m"] for each in kind.parameters)
        found = kind.unchecked(*values).enter(replace(LOW, **every))
        for name in sorted(COMPUTED_FIELDS):
            of = attrgetter("law.kn_N_m" if name == "law" else name)
            single = [of(scene) for scene in alone]
            if not np.allclose(of(found), single, rtol=1e-12, atol=0.0):
                return f"is computed, and its {name} for many drops is another than for each alone"
    except Exception as error:
        return f"is computed, and fails for many drops at once: {type(error).__name__}: {error}"
    by_chance = replace(alone[-1], chance=LOW.chance) != alone[0]
    if by_chance and not kind.random:
        return "differs by chance from drop to drop: say so by random = True"
    return ""
