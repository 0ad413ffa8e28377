"""The solver's objects that the inputs of a run become: body, mesh, contact, plan of a drop,
and the effects in it.

The fields have their values here already, resolved and checked by `config`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from ...meshes import geometry
from ...meshes.section import Circle, Rectangle, Section
from ...meshes.tip_shape import TipShape, parse_tip_shape
from ...solver import paper
from ...solver.analytic import quarter_period_s
from ...solver.arrays import Array
from ...solver.bristle import Bristle, Material
from ...solver.contact.enforcement import ContactMethod, Enforcement
from ...solver.contact.laws import ContactLaw, Coulomb, Linear, mindlin_ratio
from ...solver.drop import DropPlan, DropResult
from ...solver.effects.base import Scene
from ...solver.effects.library import enter_all
from ...solver.errors import InputError
from ...solver.ground import Ground
from ...solver.rigid import leaning, matrix_of, slope_normal
from ...solver.time.scheme import TimeScheme
from . import fields
from .choices import Contact, Deflection, Model, Scheme, Solver, Until
from .fields import DropFields, SharedFields, StepField
from .sources import checked

# How bristle and surface lean, each in degrees.
ANGLES = ("tilt_deg", "tilt_wide_deg", "slope_deg", "slope_wide_deg")
# Lean in degrees up to which small strain and rotation in contact are taken to be enough.
LINEAR_LEAN_DEG = 10.0


class Values(SharedFields):
    """What a drop and a sweep share, as objects."""

    @property
    def surface_normal(self) -> Array:
        """The surface's normal (3,) along the bristle's own axes."""
        attitude = matrix_of(leaning(self.tilt_deg, self.tilt_wide_deg))
        return np.asarray(attitude.T @ slope_normal(self.slope_deg, self.slope_wide_deg))

    @property
    def lean_deg(self) -> float:
        """Angle between the bristle and the surface's normal."""
        normal = self.surface_normal
        return math.degrees(math.atan2(math.hypot(normal[0], normal[1]), normal[2]))

    @property
    def leaning(self) -> bool:
        """Whether the tip can slide: something leans, or the tip is not flat or the bristle bent.

        A flat tip that lands upright on a level surface is pushed along its axis alone; friction
        is left out there, and a reduced model needs no bending.
        """
        if self.mesh is not None and not self.mesh.read().straight:
            return True
        return any(getattr(self, name) for name in ANGLES) or self.tip_shape != fields.FLAT

    def face(self) -> TipShape:
        """The shape of the end face."""
        return parse_tip_shape(self.tip_shape)

    def face_offsets_m(self, xy_m: Array) -> Array:
        """How far the end face stands back at places (n, 2) of the section.

        Places that rounding, or a mesh with cells not quite round, puts outside are taken to the
        edge.
        """
        section = self.end_section()
        if isinstance(section, Rectangle):
            half = 0.5 * np.array([section.thickness_m, section.width_m])
            inside = np.clip(xy_m, -half, half)
        else:
            radius = 0.5 * section.diameter_m
            inside = xy_m / np.maximum(np.hypot(*xy_m.T) / radius, 1.0)[:, None]
        return np.asarray(self.face().offset_m(inside[:, 0], inside[:, 1], section))

    def bristle(self) -> Bristle:
        """The body that falls; of a mesh, a flat wire of the same length and mass."""
        material = Material(
            self.youngs_Pa, self.poisson, self.density_kg_m3, self.alpha_1_s, self.beta_s
        )
        if self.mesh is not None:
            own = self.mesh.read()
            return Bristle(own.length_m, own.mean_section, material)
        return Bristle(self.length_m or paper.LENGTH_M, self.end_section(), material)

    def shape(self) -> geometry.MeshSpec | str:
        """What tells a solid's mesh from others: its parameters, or the digest of the user's."""
        return self.mesh_spec() if self.mesh is None else self.mesh.sha256

    def mesh_spec(self) -> geometry.MeshSpec:
        """The mesh of hexahedra; ValueError where gmsh could not make it."""
        return geometry.MeshSpec(
            self.length_m or paper.LENGTH_M,
            self.end_section(),
            self.cells or fields.CELLS,
            self.geometry_order or 1,
            self.grading or 1.0,
        )

    def end_section(self) -> Section:
        """The section at the tip."""
        if self.mesh is not None:
            return self.mesh.read().tip_section
        if self.diameter_m is not None:
            return Circle(self.diameter_m)
        return Rectangle(self.thickness_m or paper.THICKNESS_M, self.width_m or paper.WIDTH_M)

    def time_scheme(self) -> TimeScheme:
        """The time scheme with its constants."""
        if self.scheme is Scheme.GENERALISED and self.rho_inf is not None:
            return TimeScheme.generalised(self.rho_inf)
        return TimeScheme.newmark() if self.scheme is Scheme.NEWMARK else TimeScheme.average()


class DropValues(Values, DropFields, StepField):
    """One drop, as objects."""

    @property
    def may_differ(self) -> bool:
        """Whether a contact law of its own is possible in this run."""
        plain = self.scheme is Scheme.AVERAGE and self.contact is not Contact.NITSCHE
        return plain and math.isfinite(self.kn_N_m)

    @property
    def may_bend(self) -> bool:
        """Whether the axial force can act on the slope in this run."""
        return self.model in (Model.BEAM, Model.REDUCED) and self.may_differ

    @property
    def may_turn(self) -> bool:
        """Whether strain and rotation can be finite in this run."""
        return (
            self.model is Model.SOLID
            and self.scheme is Scheme.AVERAGE
            and self.solver is not Solver.ITERATIVE
        )

    @property
    def resolved_deflection(self) -> Deflection:
        """How far bending and turning go into this run: as asked for, or as it matters and can."""
        if self.deflection is not None:
            return self.deflection
        if self.leaning and self.may_turn:
            return Deflection.FINITE
        gentle = self.lean_deg <= LINEAR_LEAN_DEG
        bends = self.leaning and gentle and self.may_bend
        return Deflection.SECOND_ORDER if bends else Deflection.SMALL

    @property
    def second_order(self) -> bool:
        """Whether the axial force acts on the slope."""
        return self.resolved_deflection is Deflection.SECOND_ORDER

    @property
    def finite(self) -> bool:
        """Whether strain and rotation are finite."""
        return self.resolved_deflection is Deflection.FINITE

    def scene(self) -> Scene:
        """What the options alone make of the drop, no effect entered."""
        return Scene(
            height_m=self.height_m,
            front_m2=self.bristle().section.area_m2,
            beta_s=self.beta_s,
            law=Linear(self.kn_N_m),
            **{name: getattr(self, name) for name in ANGLES},
        )

    def friction_law(self) -> Coulomb:
        """Friction, none where nothing can slide."""
        ratio = mindlin_ratio(self.poisson) if self.kt_ratio is None else self.kt_ratio
        return Coulomb(self.friction if self.leaning else 0.0, ratio)

    def contact_method(self, law: ContactLaw | None = None) -> ContactMethod:
        """The contact law (None: linear) with friction, and its enforcement."""
        law, how = law or Linear(self.kn_N_m), Enforcement(self.contact.value)
        friction = self.friction_law()
        if self.theta is None:
            return ContactMethod(law, how, friction=friction)
        return ContactMethod(law, how, theta=self.theta, gamma0=self.gamma0, friction=friction)

    def drop_plan(self, n_points: int, scene: Scene | None = None) -> DropPlan:
        """What solver.drop.simulate is to do with a body of ``n_points`` that can touch.

        ``scene`` has what effects changed beyond the options.
        """
        scene = scene or self.scene()
        normal = slope_normal(self.slope_deg, self.slope_wide_deg)
        return DropPlan(
            height_m=self.height_m,
            method=self.contact_method(scene.law),
            its_s=self.its_s,
            gravity_m_s2=self.gravity_m_s2,
            scheme=self.time_scheme(),
            until_s=None if isinstance(self.until, Until) else self.until,
            impact_only=self.until is Until.IMPACT,
            tilt_deg=self.tilt_deg,
            tilt_wide_deg=self.tilt_wide_deg,
            ground=Ground.plane(n_points, normal),
            release_speed_m_s=scene.release_speed_m_s,
            drag_kg_m=scene.drag_kg_m,
            axes=None if self.mesh is None else self.mesh.read().axes,
        )

    def contact_s(self) -> float:
        """About how long an impact lasts: half a period on the spring, and one of the bar."""
        bristle = self.bristle()
        return 2.0 * quarter_period_s(bristle.mass_kg, self.kn_N_m) + bristle.axial_period_s

    def changed(self, **values: Any) -> Self:
        """The same drop with other ``values``, checked again; InputError as in `sources`."""
        return checked(type(self), {**self.model_dump(), **values})


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
