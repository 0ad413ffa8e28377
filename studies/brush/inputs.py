"""Inputs of a brush, checked together, and what the solver's rods are made of."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import model_validator

from ...meshes.section import Circle, Rectangle, Section
from ...solver import paper
from ...solver.arrays import Array
from ...solver.bristle import Bristle, Material
from ...solver.contact.laws import mindlin_ratio
from ...solver.materials import MATERIALS, MaterialName
from ...solver.rods.ground import Ground
from ...solver.rods.hub import FASTEST_M_S, FASTEST_RAD_S, Clamps, HubPath, HubPose
from ...solver.rods.relief import RoughPlane
from ...solver.rods.section import RodSection
from ..inputs.brush_fields import ROWS_OVER_TIME, SHORTEST_EVERY_S, BrushFields
from ..inputs.choices import Layout, Motion
from ..inputs.config import resolve_material, resolve_measures
from ..inputs.fields import BodyFields, MaterialFields
from ..inputs.flags import refuse
from ..inputs.limits import KN_N_M
from ..inputs.named import MotionInput, read_motion
from ..surface.ground import surface_of
from .layout import directions, lowest_m, overlapping, stand
from .motion import read_path, stroke

PENETRATION_M, UNTIL_S = 0.02, 1.0
MOST_ROWS = 100_000
STEEPEST_DEG = 85.0
# Instants of a path at which the clamps' height is looked at, between two rows.
LOOKS = 8
# A clamp on the surface, and a bristle that touches at the start, but for rounding.
TOUCHING_M = 1e-9


class BrushInputs(MaterialFields, BodyFields, BrushFields):
    """Every option of `bristle brush`, resolved and checked."""

    @model_validator(mode="before")
    @classmethod
    def _resolve(cls, data: Any) -> Any:
        """Fill in what depends on other options."""
        if not isinstance(data, dict):
            return data
        data = {name: value for name, value in data.items() if value is not None}
        resolve_measures(data)
        resolve_material(data)
        material = data.get("material", MaterialName.STEEL)
        if material in tuple(MaterialName):
            data.setdefault("yield_strength_Pa", MATERIALS[MaterialName(material)].yield_Pa)
        poisson = data.get("poisson", paper.POISSON)
        if isinstance(poisson, float) and -1.0 < poisson < 0.5:
            data.setdefault("kt_ratio", mindlin_ratio(poisson))
        data.setdefault("friction_between", data.get("friction", paper.FRICTION))
        data.setdefault("friction_static", data.get("friction", paper.FRICTION))
        data.setdefault("motion", cls.model_fields["motion"].default)
        data["motion"] = moved = _motion(data["motion"])
        if moved.file is not None:
            data.setdefault("until_s", _end_s(read_path(Path(moved.file.path))))
        else:
            data.setdefault("penetration_m", PENETRATION_M)
        data.setdefault("until_s", UNTIL_S)
        if isinstance(data["until_s"], float | int):
            data.setdefault("every_s", max(data["until_s"] / ROWS_OVER_TIME, SHORTEST_EVERY_S))
        return data

    @model_validator(mode="after")
    def _possible(self) -> Self:
        """Refuse what no brush can be or do."""
        if self.diameter_m is not None and (self.width_m or self.thickness_m):
            refuse("diameter_m", "a round wire has neither --width nor --thickness")
        if self.friction_static is not None and self.friction_static < self.friction:
            refuse("friction_static", f"is less than the {self.friction:g} of --friction")
        if KN_N_M < self.kn_N_m < math.inf:
            refuse("kn_N_m", f"must be {KN_N_M:g} N/m or less, or inf")
        self._check_unused()
        self._check_surface()
        if self.duration_s > MOST_ROWS * self.interval_s:
            refuse("every_s", f"makes more than {MOST_ROWS:,} rows")
        if 3.0 * self.length_std_m > self.bristle().length_m:
            refuse("length_std_m", "is more than a third of the length")
        if (steepest := float(np.abs(self._lean_deg).max())) > STEEPEST_DEG:
            refuse(
                "angle_std_deg",
                f"leans a clamp by {steepest:.3g} degrees; {STEEPEST_DEG:g} is the most",
            )
        if (shortest := float(self._lengths_m.min())) <= 0.0:
            refuse("length_std_m", f"makes a bristle {shortest:.3g} m long")
        try:
            clamps = self.clamps
        except ValueError as error:
            refuse("count", str(error))
        self._check_speed(clamps)
        if self.touch_each_other:
            self._check_apart(clamps)
        self._check_path()
        return self

    def _check_speed(self, clamps: Clamps) -> None:
        """Refuse a hub that is faster than a path from a file may be."""
        spin = 2.0 * math.pi * abs(self.motion.rpm or 0.0) / 60.0
        if spin > FASTEST_RAD_S:
            refuse("motion", f"turns at {spin:.3g} rad/s; {FASTEST_RAD_S:g} is the most")
        around = spin * float(np.linalg.norm(clamps.position_m, axis=1).max())
        fastest = max(abs(self.motion.speed_m_s or 0.0), around)
        if fastest > FASTEST_M_S:
            refuse("motion", f"moves a clamp at {fastest:.3g} m/s; {FASTEST_M_S:g} is the most")

    def _check_apart(self, clamps: Clamps) -> None:
        """Refuse bristles that overlap at the start."""
        pair = overlapping(self.section, clamps.position_m, clamps.rotation, clamps.length_m)
        if pair is not None:
            refuse("spacing_m", f"bristles {pair[0]} and {pair[1]} overlap at the start")

    def _check_unused(self) -> None:
        """Refuse an option that this layout or this motion would not look at."""
        rings, several = (Layout.RING, Layout.CUP), tuple(set(Layout) - {Layout.SINGLE})
        for name, layouts, why in (
            ("flare_deg", rings, "is for a ring or a cup, whose hub has an axis to spread from"),
            ("radius_m", rings, "is for a ring or a cup; other layouts have no radius"),
            ("tufts", (Layout.CUP,), "is for a cup; other layouts have no tufts"),
            ("rows", several, "is for more than one bristle; give --layout row, ring or cup"),
            (
                "touch_each_other",
                several,
                "is for more than one bristle; a single one has no other",
            ),
            ("spacing_m", several, "is for more than one bristle; give --layout row, ring or cup"),
        ):
            if self.layout not in layouts and getattr(self, name) != _default(name):
                refuse(name, why)
        alone = self.layout is Layout.SINGLE or not self.touch_each_other
        if alone and self.friction_between != self.friction:
            refuse("friction_between", "is of bristles that touch each other; none does here")
        if self.motion.file is not None and self.start_s != _default("start_s"):
            refuse("start_s", "is in the times of --motion file:…; leave it out")

    def _check_surface(self) -> None:
        """Refuse what says two things of a surface, or something of one that is not rough."""
        drawn, measured = self.rms_height_m is not None, self.surface is not None
        if measured and drawn:
            refuse("rms_height_m", "has no meaning with a measured surface")
        if self.correlation_length_m is not None and not drawn:
            refuse("correlation_length_m", "is of a surface that is drawn; give --rms-height")
        if self.surface_seed != _default("surface_seed") and not (drawn or measured):
            refuse("surface_seed", "is of a rough surface; give --rms-height or --surface")

    def _check_path(self) -> None:
        """Refuse a hub that takes a clamp below the surface, or starts with a bristle in it."""
        path, clamps = self.hub_motion, self.clamps
        first = path.pose(0.0)
        height = float(first.position_m[2] + self._lowest_m(first))
        if self.motion.file is None:
            depth, reach = self.penetration_m or 0.0, float(clamps.length_m.max())
            if depth >= reach:
                refuse("penetration_m", f"goes beyond the bristles' length of {reach:.4g} m")
            if first.position_m[2] - depth <= TOUCHING_M:
                refuse(
                    "penetration_m",
                    f"takes the clamps below the surface: they stand {first.position_m[2]:.4g} m "
                    "above it when the first bristle touches",
                )
            return
        if self.penetration_m is not None:
            refuse("penetration_m", "is in the heights of --motion file:…; leave it out")
        if self.duration_s > _end_s(path) + TOUCHING_M:
            refuse("until_s", f"{self.duration_s:g} s is after the path's end, {_end_s(path):g} s")
        looks = np.interp(
            np.arange(LOOKS * (len(path.breaks) - 2) + 1) / LOOKS,
            np.arange(len(path.breaks)),
            path.breaks,
        )
        for t in looks:
            pose = path.pose(t)
            if (pose.position_m[2] + clamps.position_m @ pose.rotation[2]).min() <= TOUCHING_M:
                refuse("motion", f"the path takes a clamp below the surface, at {t:.4g} s")
        if height < -TOUCHING_M:
            refuse("motion", f"a bristle starts {-height:.3g} m below the surface")

    @property
    def duration_s(self) -> float:
        """When it ends."""
        return UNTIL_S if self.until_s is None else self.until_s

    @property
    def interval_s(self) -> float:
        """Time between rows."""
        return self.duration_s / ROWS_OVER_TIME if self.every_s is None else self.every_s

    @property
    def section(self) -> Section:
        """Of each bristle."""
        if self.diameter_m is not None:
            return Circle(self.diameter_m)
        return Rectangle(self.thickness_m or paper.THICKNESS_M, self.width_m or paper.WIDTH_M)

    def bristle(self) -> Bristle:
        """A bristle of mean length."""
        material = Material(
            self.youngs_Pa, self.poisson, self.density_kg_m3, self.alpha_1_s, self.beta_s
        )
        return Bristle(self.length_m or paper.LENGTH_M, self.section, material)

    @property
    def upright(self) -> bool:
        """Whether clamps hold bristles along the vertical, but for what is drawn at random."""
        return not (self.mount_angle_deg or self.flare_deg)

    @property
    def clamps(self) -> Clamps:
        """Where each bristle is clamped, in the hub's axes; ValueError as `layout.stand` has it."""
        stood = stand(self.layout, self.count, self.rows, self.tufts, self.radius_m, self.spacing_m)
        forward = self._forward(stood.outward)
        rotation = directions(
            stood.outward, forward, self._lean_deg, self.flare_deg, self.twist_deg
        )
        place = np.column_stack([stood.place_m, np.zeros(self.count)])
        return Clamps(place, rotation, self._lengths_m)

    @property
    def _drawn(self) -> Array:
        """Numbers of chance (count, 3): a row for each, so that more bristles change no other."""
        return np.random.default_rng(self.seed).standard_normal((self.count, 3))

    @property
    def _lean_deg(self) -> Array:
        """How far each clamp leans (count, 2), in the direction of motion and across it."""
        return np.array([self.mount_angle_deg, 0.0]) + self.angle_std_deg * self._drawn[:, :2]

    @property
    def _lengths_m(self) -> Array:
        return np.asarray(self.bristle().length_m + self.length_std_m * self._drawn[:, 2])

    def _forward(self, outward: Array) -> Array:
        """The direction of motion (n, 2) of each bristle at the start."""
        sign = math.copysign(1.0, self.motion.rpm or self.motion.speed_m_s or 1.0)
        if self.motion.kind is Motion.ROTATE:
            return sign * np.column_stack([-outward[:, 1], outward[:, 0]])
        return np.tile([sign, 0.0], (len(outward), 1))

    @property
    def hub_motion(self) -> HubPath:
        """How the hub moves; a stroke begins where the first bristle touches."""
        if self.motion.file is not None:
            return read_path(Path(self.motion.file.path))
        return stroke(
            self.first_touch_m,
            self.penetration_m or 0.0,
            self.start_s,
            self.motion.speed_m_s or 0.0,
            2.0 * math.pi * (self.motion.rpm or 0.0) / 60.0,
        )

    @property
    def first_touch_m(self) -> float:
        """Height of the hub, with its axes along the world's, where the first bristle touches."""
        return -self._lowest_m(HubPath.still().pose(0.0))

    def _lowest_m(self, pose: HubPose) -> float:
        """Height over the surface of the lowest end of all straight bristles, in m, if the hub were
        at z = 0 of ``pose``."""
        clamps = self.clamps
        roots, rotation = clamps.position_m @ pose.rotation.T, pose.rotation @ clamps.rotation
        if (surface := surface_of(self)) is None:
            return float(lowest_m(self.section, roots, rotation, clamps.length_m).min())
        rim = RodSection.of(self.bristle()).rim_m
        ends = roots + clamps.length_m[:, None] * rotation[:, :, 2]
        points = ends[:, None] + np.einsum("nxk,rk->nrx", rotation[:, :, :2], rim)
        x, y = (points[..., :2] + pose.position_m[:2]).reshape(-1, 2).T
        return float((points[..., 2].ravel() - surface.patch(x, y).heights_m).min())

    @property
    def stiffness_N_m(self) -> float:
        """Kn for the solver: of an infinite one, `RodSection.rigid_N_m` of the shortest bristle."""
        if math.isfinite(self.kn_N_m):
            return self.kn_N_m
        shortest_m = float(self._lengths_m.min())
        return RodSection.of(self.bristle()).rigid_N_m(shortest_m / self.elements)

    @property
    def ground(self) -> Ground:
        """The surface, and how bristles meet it."""
        assert self.friction_static is not None
        assert self.kt_ratio is not None
        law = self.stiffness_N_m, self.friction, self.friction_static, self.stribeck_speed_m_s
        rough = None
        if (surface := surface_of(self)) is not None:
            factors = surface.stiffness_factors(self.youngs_Pa, self.poisson)
            over_kn = factors[surface.phase]
            if math.isinf(self.kn_N_m):
                over_kn = np.ones_like(over_kn)
            rough = RoughPlane(surface.heights_m, surface.spacing_m, over_kn)
        return Ground(*law, self.kt_ratio, rough=rough)

    @property
    def steady_from_s(self) -> float:
        """When means begin: after the hub has come down, or at the start of a path."""
        return 0.0 if self.motion.file is not None else min(self.start_s, self.duration_s)


def _default(name: str) -> Any:
    return BrushInputs.model_fields[name].default


def _motion(value: Any) -> MotionInput:
    """A motion of what was given; ends validation where it is none."""
    try:
        moved = read_motion(value)
    except ValueError as error:
        refuse("motion", str(error))
    if not isinstance(moved, MotionInput):
        refuse("motion", f"must be text such as slide:speed=1, not {value!r}")
    return moved


def _end_s(path: HubPath) -> float:
    """When the last row of a file's path is reached; the hub then rests."""
    return float(path.breaks[-2])
