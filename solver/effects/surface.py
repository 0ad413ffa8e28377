"""Effects of the landing, constant or different from drop to drop."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array
from ..contact.laws import Linear
from ..errors import InputError
from .base import TOUCHING, Effect, Parameter, Place, Scene

# Number of drops to which the parameter of wear refers.
WEAR_DROPS = 100.0
MOST_SLOPE_DEG = 10.0
# Beyond any table's stiffness: drops may be numbered by date, and wear grows with the number.
MOST_DECADES = 12.0


@dataclass(frozen=True)
class BristleTilt(Effect):
    """The bristle leans toward its thin side, equally in every drop."""

    tilt_deg: float = 2.0

    name = "bristle_tilt"
    leaning = True
    title = "a bristle that leans"
    place = Place.RELEASE
    kinds = TOUCHING
    source = "the paper's discussion: bristles are not vertical"
    parameters = (
        Parameter("tilt_deg", "°", 0.0, 8.0, 2.0, why="more than 8° anybody would have seen"),
    )

    def enter(self, scene: Scene) -> Scene:
        return replace(scene, tilt_deg=scene.tilt_deg + self.tilt_deg)


@dataclass(frozen=True)
class SurfaceSlope(Effect):
    """The slope of an asperity under the tip, different in each drop, with Coulomb friction.

    Slopes toward the thin and the wide side are normal with this standard deviation, but none is
    steeper than `MOST_SLOPE_DEG`: their size has a truncated Rayleigh distribution.
    """

    std_deg: float = 3.0

    name = "surface_slope"
    leaning = True
    title = "asperity slopes"
    place = Place.SURFACE
    kinds = TOUCHING
    source = "the paper's discussion: a rough surface; Nayak, J. Lubr. Tech. 93 (1971)"
    parameters = (
        Parameter("std_deg", "°", 0.0, 8.0, 3.0, why="rms slope of concrete at a tip's size"),
    )
    random = True

    def enter(self, scene: Scene) -> Scene:
        thin, wide = scene.chance[:2]
        size = math.hypot(thin, wide)
        each = float(steepness_deg(size, self.std_deg)) / max(size, 1e-300)
        return replace(
            scene,
            slope_deg=scene.slope_deg + each * thin,
            slope_wide_deg=scene.slope_wide_deg + each * wide,
        )


def steepness_deg(size: Array | float, std_deg: Array | float) -> Array:
    """The slope for a deviate of Rayleigh's distribution, by the inverse of the distribution
    truncated at `MOST_SLOPE_DEG`; arrays broadcast."""
    most = MOST_SLOPE_DEG / np.maximum(std_deg, 1e-9)
    share = np.expm1(-0.5 * np.square(size)) * np.expm1(-0.5 * np.square(most))
    return np.asarray(std_deg * np.sqrt(-2.0 * np.log1p(-share)))


def _stiffer(scene: Scene, decades: float) -> Scene:
    """The scene with Kn times 10^decades, within `MOST_DECADES`, under a linear law."""
    if type(scene.law) is not Linear:
        raise InputError(
            "a stiffness that varies goes before a law of its own", inputs=("effects",)
        )
    times = 10.0 ** np.clip(decades, -MOST_DECADES, MOST_DECADES)
    return replace(scene, law=Linear(scene.law.kn_N_m * times))


@dataclass(frozen=True)
class SurfacePhases(Effect):
    """Cement here, aggregate there: the contact stiffness is log-normal from drop to drop."""

    std_decades: float = 0.3

    name = "surface_phases"
    computed = True
    title = "stiffness that differs from drop to drop"
    place = Place.SURFACE
    kinds = TOUCHING
    source = "the paper's phases: cement 12 GPa, coarse aggregate 69 GPa, fine aggregate 80 GPa"
    parameters = (
        Parameter("std_decades", "decades", 0.0, 1.0, 0.3, why="12 to 80 GPa are 0.8 decades"),
    )
    random = True

    def enter(self, scene: Scene) -> Scene:
        return _stiffer(scene, self.std_decades * scene.chance[0])


@dataclass(frozen=True)
class Wear(Effect):
    """Contact becomes stiffer or softer with the number of drops: wear of tip or surface."""

    decades: float = 0.5

    name = "wear"
    computed = True
    title = "drift with the order of drops"
    place = Place.SURFACE
    kinds = TOUCHING
    source = "Archard, J. Appl. Phys. 24 (1953): wear in proportion to the number of contacts"
    parameters = (
        Parameter(
            "decades",
            "decades per 100 drops",
            -4.0,
            4.0,
            0.5,
            why="of Kn; a tip that wears flat or a surface that crumbles",
        ),
    )

    def enter(self, scene: Scene) -> Scene:
        return _stiffer(scene, self.decades * scene.order / WEAR_DROPS)


@dataclass(frozen=True)
class Session(Effect):
    """Contact is stiffer or softer on another day: another place, another tip, other weather."""

    decades: float = 0.1

    name = "session"
    computed = True
    title = "a difference between sessions"
    place = Place.SURFACE
    kinds = frozenset({"drops"})
    source = (
        "block effects: G. E. P. Box, J. S. Hunter and W. G. Hunter, Statistics for Experimenters"
    )
    parameters = (
        Parameter(
            "decades",
            "decades",
            -1.0,
            1.0,
            0.1,
            why="of Kn; 12 to 80 GPa, the phases of concrete, are 0.8 decades",
        ),
    )

    def enter(self, scene: Scene) -> Scene:
        return _stiffer(scene, self.decades * scene.session)
