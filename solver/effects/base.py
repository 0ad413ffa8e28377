"""An effect: a named piece of physics, its parameters, and the one place where it enters.

An effect is a small frozen class. It changes one field of a `Scene`, the description of a drop.
Beam, reduced solid and full solid are built from the same scene, so an effect found with the beam
can be switched on in three dimensions unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any, ClassVar, Self

from .. import paper
from ..contact.laws import ContactLaw, Linear
from ..errors import InputError

# Kinds of datasets with contact.
TOUCHING = frozenset({"drops", "tracks", "forces"})


class Place(StrEnum):
    """Where an effect enters."""

    RELEASE = "release"
    FLIGHT = "flight"
    BODY = "body"
    CONTACT = "contact law"
    SURFACE = "surface"
    OBSERVATION = "observation"


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect or a model.

    The effect is absent at the value ``null``. ``low`` and ``high`` are bounds, ``typical`` is a
    first guess, ``why`` the source of the bounds. A ``logarithmic`` parameter is uniform in its
    logarithm. One that ``refines`` stays at its null if the effect's others explain data as well.
    """

    name: str
    unit: str
    low: float
    high: float
    typical: float
    null: float = 0.0
    logarithmic: bool = False
    why: str = ""
    refines: bool = False


@dataclass(frozen=True)
class Scene:
    """All inputs of one drop and of its observation, before and after effects; of many drops at
    once if its fields are arrays (`Effect.computed`).

    ``order`` counts drops from zero in the order of the measurements, ``session`` is zero in the
    first of two sessions and one in the second. ``chance`` are this drop's standard normal numbers
    for random effects. ``loss_factor`` is the loss per radian of every elastic mode over its
    energy, independent of frequency. ``front_m2`` is the frontal area, ``drag_kg_m`` drag force
    over the square of the speed, ``lateral_inertia`` the share of Love's correction in a beam.
    Observed heights are ``y_scale`` × (true + ``y_offset_m``), observed times ``t_scale`` × true.
    """

    height_m: float = 0.05
    order: int = 0
    chance: tuple[float, ...] = (1.0, 0.0)
    release_speed_m_s: float = 0.0
    front_m2: float = paper.WIDTH_M * paper.THICKNESS_M
    drag_kg_m: float = 0.0
    beta_s: float = 0.0
    loss_factor: float = 0.0
    lateral_inertia: float = 0.0
    law: ContactLaw = field(default_factory=lambda: Linear(paper.KN_CHOSEN_N_M))
    tilt_deg: float = 0.0
    tilt_wide_deg: float = 0.0
    slope_deg: float = 0.0
    slope_wide_deg: float = 0.0
    y_offset_m: float = 0.0
    y_scale: float = 1.0
    t_scale: float = 1.0
    session: float = 1.0


@dataclass(frozen=True)
class Effect:
    """Base of effects: the fields are the parameters' values, in their order.

    A subclass declares its ``name``, ``title``, ``place``, ``source`` and ``parameters``, and the
    ``kinds`` of datasets that can contain it, and overrides `enter`. ``random`` effects vary from
    drop to drop by `Scene.chance`; ``leaning`` ones tilt bristle or surface. A ``computed`` effect
    changes only release, flight, stiffness or readings, so its drops follow from those without it,
    and `enter` accepts arrays. ``origin`` names the source of an effect from outside this program.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    place: ClassVar[Place]
    kinds: ClassVar[frozenset[str]]
    source: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    random: ClassVar[bool] = False
    leaning: ClassVar[bool] = False
    computed: ClassVar[bool] = False
    origin: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for parameter in self.parameters:
            value = getattr(self, parameter.name)
            try:
                inside = parameter.low <= value <= parameter.high
            except TypeError:
                raise InputError(
                    f"{self.name}: {parameter.name} must be a number, not {value!r}"
                ) from None
            if not inside:
                raise InputError(
                    f"{self.name}: {parameter.name} must lie between {parameter.low:g} "
                    f"and {parameter.high:g} {parameter.unit}".rstrip()
                    + f", not {value:g}"
                )

    @classmethod
    def unchecked(cls, *values: Any) -> Self:
        """The effect with these parameter values, arrays allowed, without a check of bounds."""
        effect = object.__new__(cls)
        for each, value in zip(fields(cls), values, strict=True):
            object.__setattr__(effect, each.name, value)
        return effect

    def values(self) -> tuple[float, ...]:
        """The parameters' values, in their order."""
        return tuple(getattr(self, each.name) for each in fields(self))

    def enter(self, scene: Scene) -> Scene:
        """The scene with this effect applied."""
        raise NotImplementedError
