"""Shapes of the end face: the offset of a worn or chamfered face from a plane.

The section is centred on x = y = 0: thickness along x and width along y, or a round wire.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from .section import Rectangle, Section, require_positive

Array = npt.NDArray[np.float64]

OUTSIDE = 1e-6
"""Part of the section by which a point may be outside, from rounding."""


class TipShape(Protocol):
    """The shape of an end face; ValueError if a parameter is out of range."""

    def offset_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike, section: Section) -> Array:
        """Offset of the face at positions (x, y) of the section, m, each (n,).

        It is never negative, and 0 at the lowest place of the face. ValueError if a position is
        outside the section, or the shape does not fit on it.
        """
        ...


def half_breadth_m(section: Section) -> float:
    """Largest distance of a position in the section from the nearest edge, m."""
    if isinstance(section, Rectangle):
        return min(section.thickness_m, section.width_m) / 2
    return section.diameter_m / 2


def edge_distance_m(x_m: npt.ArrayLike, y_m: npt.ArrayLike, section: Section) -> Array:
    """Distance of positions (x, y) from the nearest edge of the section, m, each (n,).

    ValueError if one is outside the section by more than rounding.
    """
    x, y = np.asarray(x_m, dtype=float), np.asarray(y_m, dtype=float)
    limit = half_breadth_m(section)
    if isinstance(section, Rectangle):
        inside = np.minimum(section.thickness_m / 2 - np.abs(x), section.width_m / 2 - np.abs(y))
    else:
        inside = limit - np.hypot(x, y)
    if not (inside >= -2 * OUTSIDE * limit).all():
        raise ValueError(f"a place of the tip is {-inside.min():.3g} m outside its section.")
    return np.maximum(inside, 0.0)


def _within_m(
    name: str, breadth_m: float, x_m: npt.ArrayLike, y_m: npt.ArrayLike, section: Section
) -> Array:
    """Distance of positions (x, y) within an edge of width ``breadth_m``, m, each (n,)."""
    room = half_breadth_m(section)
    if breadth_m > room * (1 + 1e-9):
        raise ValueError(f"{name} {breadth_m:g} is more than half the section, {room:g} m.")
    return np.maximum(breadth_m - edge_distance_m(x_m, y_m, section), 0.0)


@dataclass(frozen=True)
class Flat:
    """A face square to the axis."""

    def offset_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike, section: Section) -> Array:
        return np.zeros_like(edge_distance_m(x_m, y_m, section))


@dataclass(frozen=True)
class Chamfer:
    """All edges of the face cut off along planes (the rim of a round wire along a cone).

    ``width_m`` is the chamfer's extent into the face from its edge, ``angle_deg`` the angle between
    chamfer and face, above 0 and below 90°.
    """

    width_m: float
    angle_deg: float = 45.0

    def __post_init__(self) -> None:
        require_positive("width_m", self.width_m)
        require_positive("angle_deg", self.angle_deg)
        if self.angle_deg >= 90:
            raise ValueError(f"angle_deg of a chamfer must be below 90, not {self.angle_deg!r}.")

    def offset_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike, section: Section) -> Array:
        """(width - e) tan(angle) within the width, e the distance from the nearest edge."""
        within = _within_m("width_m", self.width_m, x_m, y_m, section)
        return within * math.tan(math.radians(self.angle_deg))


@dataclass(frozen=True)
class Rounded:
    """All edges of the face rounded; a round wire of twice the radius ends in a half sphere.

    ``radius_m`` is that of the quarter circle at the edge.
    """

    radius_m: float

    def __post_init__(self) -> None:
        require_positive("radius_m", self.radius_m)

    def offset_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike, section: Section) -> Array:
        """r - √(r² - (r - e)²) within r of the edge, e the distance from it."""
        radius = self.radius_m
        within = _within_m("radius_m", radius, x_m, y_m, section)
        return within**2 / (radius + np.sqrt(np.maximum(radius**2 - within**2, 0.0)))


@dataclass(frozen=True)
class Worn:
    """A slanted plane face, as worn by a leaning bristle.

    ``angle_deg`` is the angle between the face and the plane normal to the axis, from 0 to below
    90°, ``direction_deg`` the direction of greatest offset, from +x (thickness) toward +y (width).
    """

    angle_deg: float
    direction_deg: float = 0.0

    def __post_init__(self) -> None:
        if isinstance(self.angle_deg, bool) or self.angle_deg != 0:
            require_positive("angle_deg", self.angle_deg)
        if self.angle_deg >= 90:
            raise ValueError(f"angle_deg of a worn tip must be below 90, not {self.angle_deg!r}.")
        if isinstance(self.direction_deg, bool) or not math.isfinite(self.direction_deg):
            raise ValueError(f"direction_deg must be a number, not {self.direction_deg!r}.")

    def offset_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike, section: Section) -> Array:
        """tan(angle) times the distance from the lowest edge, along the direction."""
        edge_distance_m(x_m, y_m, section)  # raises for places outside
        direction = math.radians(self.direction_deg)
        along = np.array([math.cos(direction), math.sin(direction)])
        if isinstance(section, Rectangle):
            reach = float(np.abs(along) @ (section.thickness_m / 2, section.width_m / 2))
        else:
            reach = half_breadth_m(section)
        travelled = np.asarray(x_m) * along[0] + np.asarray(y_m) * along[1] + reach
        return np.maximum(travelled, 0.0) * math.tan(math.radians(self.angle_deg))


_SHAPES = {"flat": Flat, "chamfer": Chamfer, "rounded": Rounded, "worn": Worn}


def parse_tip_shape(text: str) -> Flat | Chamfer | Rounded | Worn:
    """Read a shape from text such as `chamfer:width=5e-5,angle=45`.

    The others: `flat`, `rounded:radius=1e-4`, `worn:angle=5,direction=90`. Lengths in m, angles in
    degrees; `angle` of a chamfer and `direction` are optional. ValueError if the shape or a
    parameter is unknown, missing, given twice or not a number.
    """
    name, colon, rest = text.strip().partition(":")
    if name not in _SHAPES:
        raise ValueError(f"tip shape '{name}' is not known; there are {', '.join(_SHAPES)}.")
    kind = _SHAPES[name]
    fields = {field.name.rsplit("_", 1)[0]: field for field in dataclasses.fields(kind)}
    values: dict[str, float] = {}
    for pair in rest.split(",") if colon else []:
        key, equals, value = (part.strip() for part in pair.partition("="))
        if not equals:
            raise ValueError(f"tip shape '{text}': '{pair}' is not parameter=value.")
        if key not in fields:
            names = ", ".join(fields) or "none"
            raise ValueError(f"tip shape '{text}': {name} has no '{key}', it has {names}.")
        if fields[key].name in values:
            raise ValueError(f"tip shape '{text}': {key} is given twice.")
        try:
            values[fields[key].name] = float(value)
        except ValueError:
            raise ValueError(f"tip shape '{text}': {key} = '{value}' is not a number.") from None
    for key, field in fields.items():
        if field.default is dataclasses.MISSING and field.name not in values:
            raise ValueError(f"tip shape '{text}': {key} is missing.")
    try:
        return kind(**values)
    except ValueError as error:
        raise ValueError(f"tip shape '{text}': {error}") from error
