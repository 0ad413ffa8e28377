"""Drops with effects in them: what an effect changes, and which ones a model can have."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...solver.drop import DropResult
from ...solver.effects.base import Place, Scene
from ...solver.effects.library import enter_all
from ...solver.errors import InputError
from .choices import Model
from .flags import refuse
from .values import ANGLES, DropValues


@dataclass(frozen=True)
class Entered[Drop: DropValues]:
    """A drop with its effects in: ``inputs`` names none any more, ``scene`` holds what no option
    says."""

    inputs: Drop
    scene: Scene


def entered[Drop: DropValues](inputs: Drop) -> Entered[Drop]:
    """The drop with all its effects in. Raises InputError where they make it impossible."""
    if not inputs.effects:
        return Entered(inputs, inputs.scene())
    scene = enter_all(inputs.scene(), [each.effect() for each in inputs.effects])
    plain = inputs.changed(
        effects=(),
        kn_N_m=scene.law.kn_N_m,
        beta_s=scene.beta_s,
        **{name: getattr(scene, name) for name in ANGLES},
    )
    return Entered(plain, scene)


def observed(result: DropResult, scene: Scene) -> DropResult:
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


def check_effects(inputs: DropValues) -> None:
    """Refuse effects that the model, the enforcement or the scheme cannot have."""
    scene = inputs.scene()
    try:
        effects = [each.effect() for each in inputs.effects]
        after = enter_all(scene, effects)
    except InputError as error:
        refuse("effects", str(error))
        return
    places = {effect.place for effect in effects}
    if inputs.model is Model.ANALYTIC:
        for effect in effects:
            leans = any(getattr(after, name) for name in ANGLES)
            if effect.place in (Place.BODY, Place.CONTACT) or leans:
                refuse(
                    "effects", f"{effect.name} is not for the analytic model, a mass on a spring"
                )
    if Place.CONTACT in places and not inputs.may_differ:
        refuse(
            "effects",
            "a contact law of its own needs --scheme average, a finite --kn, and penalty or "
            "augmented",
        )
    if after.loss_factor and not inputs.may_bend:
        refuse(
            "effects",
            "hysteretic_damping belongs to modes: take the beam, or the solid reduced to its modes "
            "(--model reduced), with --scheme average, a finite --kn, and penalty or augmented",
        )
    if (after.release_speed_m_s or after.drag_kg_m) and inputs.alpha_1_s:
        refuse("effects", "air_drag and release_velocity exclude --alpha, which is drag itself")
