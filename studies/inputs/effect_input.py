"""The option `--effect`: an effect by name with its parameters."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict

from ...solver.errors import InputError
from .texts import hints

if TYPE_CHECKING:
    from ...solver.effects.base import Effect


class EffectInput(BaseModel):
    """An effect by name, with all its parameters in SI (angles in degrees)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    parameters: dict[str, float] = {}

    def effect(self) -> Effect:
        """The effect itself; ValueError where it or a parameter is unknown or out of bounds."""
        kind = _kind(self.name)
        names = [field.name for field in fields(kind)]
        for name in self.parameters:
            if name not in names:
                near = hints(name, names) or [f"it has {', '.join(names)}"]
                raise ValueError(f"{self.name} has no parameter '{name}'; {near[0]}")
        try:
            return kind(**self.parameters)
        except InputError as error:
            raise ValueError(str(error).removeprefix("--effect ")) from None

    @classmethod
    def of(cls, effect: Effect) -> EffectInput:
        """The same in words."""
        values = {field.name: float(getattr(effect, field.name)) for field in fields(effect)}
        return cls(name=effect.name, parameters=values)


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
    return EffectInput(name=_kind(name.strip()).name, parameters=parameters)


def _kind(name: str) -> type[Effect]:
    """The effect of this name; ValueError with a near one where there is none."""
    from ...solver.effects.library import EFFECTS
    from ...solver.effects.outside import load_installed

    if name not in EFFECTS:
        load_installed()
    if name in EFFECTS:
        return EFFECTS[name]
    near = hints(name, EFFECTS) or [f"there are {', '.join(EFFECTS)}"]
    raise ValueError(f"names an unknown effect '{name}'; {near[0]}")


def read_effects(value: Any) -> Any:
    """Effects from texts or from what a result holds; ValueError where one is malformed."""
    if not isinstance(value, list | tuple):
        raise ValueError(f"must be a list of NAME:param=value,…, not {value!r}")
    found: list[EffectInput] = []
    for item in value:
        given = parse_effect(item) if isinstance(item, str) else EffectInput.model_validate(item)
        if any(given.name == other.name for other in found):
            raise ValueError(f"names {given.name} twice")
        found.append(EffectInput.of(given.effect()))
    return tuple(found)
