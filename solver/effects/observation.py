"""Effects of observation: differences between measured and true values."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .base import TOUCHING, Effect, Parameter, Place, Scene


@dataclass(frozen=True)
class HeightOffset(Effect):
    """Heights are read from a wrong zero: all of them by the same length."""

    offset_m: float = 1e-3

    name = "height_offset"
    computed = True
    title = "zero of the heights"
    place = Place.OBSERVATION
    kinds = TOUCHING
    source = "a scale that does not start at the surface"
    parameters = (Parameter("offset_m", "m", -5e-3, 5e-3, 1e-3, why="what an eye would not see"),)

    def enter(self, scene: Scene) -> Scene:
        return replace(scene, y_offset_m=scene.y_offset_m + self.offset_m)


@dataclass(frozen=True)
class ScaleError(Effect):
    """All heights are read too large or too small by the same factor."""

    relative: float = 0.05

    name = "scale_error"
    computed = True
    title = "scale of the heights"
    place = Place.OBSERVATION
    kinds = TOUCHING
    source = "a scale that stands nearer to the camera than the bristle"
    parameters = (Parameter("relative", "", -0.2, 0.2, 0.05, why="parallax of a scale in view"),)

    def enter(self, scene: Scene) -> Scene:
        return replace(scene, y_scale=scene.y_scale * (1.0 + self.relative))


@dataclass(frozen=True)
class ClockError(Effect):
    """All times are read too long or too short by the same factor."""

    relative: float = 0.02

    name = "clock_error"
    computed = True
    title = "rate of the clock"
    place = Place.OBSERVATION
    kinds = TOUCHING
    source = "a camera whose frame rate is not the stated one"
    parameters = (Parameter("relative", "", -0.2, 0.2, 0.02, why="consumer cameras and sensors"),)

    def enter(self, scene: Scene) -> Scene:
        return replace(scene, t_scale=scene.t_scale * (1.0 + self.relative))
