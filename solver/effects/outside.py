"""Effects from outside: classes in a user's file, or in installed packages.

A package names its classes under the entry point `ENTRY_POINT`. What is taken in is checked first:
beam, reduced solid, solid and the loop take it from then on, or it is refused with the reason.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import re
import sys
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from ..errors import InputError
from .base import Effect, Parameter, Place, Scene
from .contact import TOUCHING
from .library import EFFECTS

ENTRY_POINT = "bristle.effects"
# What a simulated drop takes from its scene; the rest the loop computes from the effects it knows.
SIMULATED_FIELDS = {"law", "beta_s", "loss_factor"}
MOST_PARAMETERS = 2


def load(path: Path) -> list[type[Effect]]:
    """Take in the effects of a Python file; ValueError where it has none, or one is refused."""
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from None
    name = f"bristle_plugin_{digest[:16]}"
    if name not in sys.modules:
        sys.modules[name] = _executed(path, name)
    own = [
        each
        for each in vars(sys.modules[name]).values()
        if isinstance(each, type) and issubclass(each, Effect) and each.__module__ == name
    ]
    if not own:
        raise ValueError(f"{path}: defines no subclass of bristle.solver.effects.base.Effect")
    for each in own:
        try:
            register(each, digest)
        except InputError as error:
            raise ValueError(f"{path}: {error}") from None
    return own


def _executed(path: Path, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{path}: is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{path}: {type(error).__name__}: {error}") from error
    finally:
        del sys.modules[name]
    return module


@lru_cache(maxsize=1)
def load_installed() -> None:
    """Take in the effects of installed packages; one that cannot be is left out with a warning."""
    for point in entry_points(group=ENTRY_POINT):
        try:
            kind = point.load()
            package = point.dist
            register(kind, f"{point.value} {package.version if package else ''}")
        except Exception as error:
            logging.getLogger("bristle").warning(
                "the effect %s of an installed package is left out: %s", point.name, error
            )


def register(kind: type[Effect], origin: str) -> None:
    """Take in an effect; ``origin`` tells its source from others. InputError says what is wrong."""
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
    """What is wrong with an effect, or an empty text."""
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
    """What is wrong with how an effect acts, tried on drops; or an empty text."""
    typical = kind(**{each.name: each.typical for each in kind.parameters})
    absent = kind(**{each.name: each.null for each in kind.parameters})
    low, high = Scene(height_m=0.01), Scene(height_m=0.05)
    changed = {
        each.name
        for scene in (low, high)
        for each in fields(Scene)
        if getattr(typical.enter(scene), each.name) != getattr(scene, each.name)
    }
    if not changed:
        return "changes nothing at its typical size"
    if not kind.kinds:
        return ""
    if len(kind.parameters) > MOST_PARAMETERS:
        return f"the loop takes at most {MOST_PARAMETERS} parameters"
    other = sorted(changed - SIMULATED_FIELDS)
    if other:
        return (
            f"changes {', '.join(other)}, which the loop takes from its own effects alone; "
            "give it no kinds, for simulations only"
        )
    if kind.random or any(
        typical.enter(replace(low, **late)) != replace(typical.enter(low), **late)
        for late in ({"order": 7}, {"chance": (-1.0, 2.0)})
    ):
        return "differs from drop to drop, which the loop knows of its own effects alone"
    if any(absent.enter(scene) != scene for scene in (low, high)):
        return "changes drops where its parameters are those of its absence"
    return ""
