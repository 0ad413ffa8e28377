"""How is an effect named on the command line, and what does a drop become with it in?"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict

from ..solver.contact.laws import Linear
from ..solver.drop import DropResult
from ..solver.effects.base import Effect, Place, Scene
from ..solver.effects.library import EFFECTS, enter_all
from ..solver.errors import InputError
from .command.choices import Contact, Model, Scheme
from .sections.stance import ANGLES

if TYPE_CHECKING:
    from .command.config import DropInputs


class EffectInput(BaseModel):
    """An effect by name, with all its parameters in SI (angles in degrees)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    parameters: dict[str, float] = {}

    def effect(self) -> Effect:
        """The effect itself; ValueError where a parameter is unknown or out of bounds."""
        kind = EFFECTS[known(self.name)]
        names = [field.name for field in fields(kind)]
        for name in self.parameters:
            if name not in names:
                near = difflib.get_close_matches(name, names, 1)
                hint = f"did you mean {near[0]}?" if near else f"it has {', '.join(names)}"
                raise ValueError(f"{self.name} has no parameter '{name}'; {hint}")
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
    found: list[EffectInput] = []
    for item in value:
        given = parse_effect(item) if isinstance(item, str) else EffectInput.model_validate(item)
        if any(given.name == other.name for other in found):
            raise ValueError(f"names {given.name} twice")
        found.append(EffectInput.of(given.effect()))
    return tuple(found)


@dataclass(frozen=True)
class Entered:
    """A drop with its effects in: ``inputs`` names none any more, ``scene`` holds what no option
    says."""

    inputs: DropInputs
    scene: Scene


def scene_of(inputs: DropInputs) -> Scene:
    """What the options alone make of a drop."""
    return Scene(
        height_m=inputs.height_m,
        front_m2=inputs.bristle().section.area_m2,
        beta_s=inputs.beta_s,
        law=Linear(inputs.kn_N_m),
        **{name: getattr(inputs, name) for name in ANGLES},
    )


def entered(inputs: DropInputs) -> Entered:
    """The drop with all its effects in. Raises InputError where they make it impossible."""
    if not inputs.effects:
        return Entered(inputs, scene_of(inputs))
    scene = enter_all(scene_of(inputs), [each.effect() for each in inputs.effects])
    plain = inputs.changed(
        effects=(),
        kn_N_m=scene.law.kn_N_m,
        beta_s=scene.beta_s,
        **{name: getattr(scene, name) for name in ANGLES},
    )
    return Entered(plain, scene)


def seen(result: DropResult, scene: Scene) -> DropResult:
    """The result as instruments see it, heights and times off by what the scene says."""
    if (scene.y_offset_m, scene.y_scale, scene.t_scale) == (0.0, 1.0, 1.0):
        return result

    def height(true_m: float | None) -> float | None:
        return None if true_m is None else scene.y_scale * (true_m + scene.y_offset_m)

    start = height(scene.height_m)
    assert start is not None
    if start <= 0.0:
        raise InputError("--effect: with this zero the bristle is released at or below the surface")
    tip = height(result.rebound_height_m)
    return replace(
        result,
        rebound_height_m=tip,
        rebound_ratio=None if tip is None else tip / start,
        cm_rebound_height_m=height(result.cm_rebound_height_m),
        contact_time_s=scene.t_scale * result.contact_time_s,
        time_to_max_penetration_s=scene.t_scale * result.time_to_max_penetration_s,
    )


def check_effects(inputs: DropInputs, refuse: Callable[[str, str], None]) -> None:
    """Refuse effects that the model, the enforcement or the scheme cannot have."""
    scene = scene_of(inputs)
    try:
        effects = [each.effect() for each in inputs.effects]
        after = enter_all(scene, effects)
    except InputError as error:
        refuse("effects", str(error).removeprefix("--effect: "))
        return
    places = {effect.place for effect in effects}
    plain = inputs.scheme is Scheme.AVERAGE and inputs.contact is not Contact.NITSCHE
    compiled = plain and math.isfinite(inputs.kn_N_m) and not inputs.march
    if inputs.model is Model.ANALYTIC:
        for effect in effects:
            leans = any(getattr(after, name) for name in ANGLES)
            if effect.place in (Place.BODY, Place.CONTACT) or leans:
                refuse(
                    "effects", f"{effect.name} is not for the analytic model, a mass on a spring"
                )
    if Place.CONTACT in places and not (plain and math.isfinite(inputs.kn_N_m)):
        refuse(
            "effects",
            "a contact law of its own needs --scheme average, a finite --kn, and penalty or "
            "augmented",
        )
    if after.loss_factor and not (compiled and inputs.model in (Model.BEAM, Model.REDUCED)):
        refuse(
            "effects",
            "hysteretic_damping belongs to modes: take the beam, or the solid reduced to its modes "
            "(--model reduced), with --scheme average, a finite --kn, and penalty or augmented",
        )
    moving = after.release_speed_m_s or after.drag_kg_m
    if moving and inputs.march:
        refuse("effects", "air_drag and release_velocity belong to events; leave --march out")
    if moving and inputs.alpha_1_s:
        refuse("effects", "air_drag and release_velocity exclude --alpha, which is drag itself")
