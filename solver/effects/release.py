"""Effects at release and in flight."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .base import TOUCHING, Effect, Parameter, Place, Scene

# Dry air at 20 °C and 1013 hPa (ISO 2533 extrapolated from 15 °C).
AIR_KG_M3 = 1.204


@dataclass(frozen=True)
class AirDrag(Effect):
    """Quadratic drag on the leading end: ½ ρ c_d A v²."""

    cd: float = 1.1

    name = "air_drag"
    computed = True
    title = "air drag"
    place = Place.FLIGHT
    kinds = TOUCHING | {"falls"}
    source = "Hoerner, Fluid-Dynamic Drag (1965), ch. 3: blunt bodies, c_d from 0.8 to 1.2"
    parameters = (
        Parameter(
            "cd", "", 0.0, 100.0, 1.1, why="of the end section; skin friction may exceed its own"
        ),
    )

    def enter(self, scene: Scene) -> Scene:
        drag = 0.5 * AIR_KG_M3 * self.cd * scene.front_m2
        return replace(scene, drag_kg_m=scene.drag_kg_m + drag)


@dataclass(frozen=True)
class ReleaseVelocity(Effect):
    """A release not at rest: the bristle starts with a speed, positive downward."""

    speed_m_s: float = 0.1

    name = "release_velocity"
    computed = True
    title = "speed at release"
    place = Place.RELEASE
    kinds = TOUCHING
    source = "v_i² = v_0² + 2 g y_0 in place of Eq. 1"
    parameters = (
        Parameter(
            "speed_m_s", "m/s", -0.5, 0.5, 0.1, why="a hand moves by some 0.1 m/s as it opens"
        ),
    )

    def enter(self, scene: Scene) -> Scene:
        return replace(scene, release_speed_m_s=scene.release_speed_m_s + self.speed_m_s)
