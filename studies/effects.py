"""How is a further piece of physics named on the command line, and is the name known?"""

from __future__ import annotations

import difflib
import math
from typing import Any

from pydantic import BaseModel, ConfigDict

from .choices import EFFECTS


class EffectInput(BaseModel):
    """An effect by name, with its parameters in SI."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    parameters: dict[str, float] = {}


def parse_effect(text: str) -> EffectInput:
    """Read ``NAME:param=value,…``; ValueError says what is wrong with it."""
    name, colon, rest = text.partition(":")
    parameters: dict[str, float] = {}
    for part in rest.split(",") if colon else ():
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not key or not equals:
            raise ValueError(f"must be NAME:param=value,…, not '{text}'")
        if key in parameters:
            raise ValueError(f"gives '{key}' twice in '{text}'")
        try:
            parameters[key] = float(value)
        except ValueError:
            raise ValueError(f"must give '{key}' a number, not '{value}'") from None
        if not math.isfinite(parameters[key]):
            raise ValueError(f"must give '{key}' a finite number, not '{value}'")
    return EffectInput(name=known(name.strip()), parameters=parameters)


def known(name: str) -> str:
    """The name itself; ValueError with a near one where it is not an effect."""
    if name in EFFECTS:
        return name
    near = difflib.get_close_matches(name, EFFECTS, 1)
    hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(EFFECTS)}"
    raise ValueError(f"names an unknown effect '{name}'; {hint}")


def read_effects(value: Any) -> Any:
    """Effects from texts or from what a result holds; ValueError where one is malformed."""
    if not isinstance(value, list | tuple):
        raise ValueError(f"must be a list of NAME:param=value,…, not {value!r}")
    effects = [parse_effect(item) if isinstance(item, str) else item for item in value]
    if effects:
        names = ", ".join(known(_name(effect)) for effect in effects)
        raise ValueError(f"asks for {names}: effects come with a later version, this one has none")
    return ()


def _name(effect: Any) -> str:
    return str(effect.get("name") if isinstance(effect, dict) else getattr(effect, "name", effect))
