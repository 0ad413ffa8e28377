"""Inputs of a run, checked together, and the solver's objects that they become.

Values arrive from flags, a configuration file or a program, are checked here once, and leave as
frozen models in SI units that know how to become the solver's objects.
"""

from __future__ import annotations

import math
from typing import Any, Self

from pydantic import model_validator

from ...solver import paper
from ...solver.contact.enforcement import GAMMA0, GAMMA0_RIGID
from ...solver.contact.laws import mindlin_ratio
from ...solver.effects.base import Place
from ...solver.effects.library import enter_all
from ...solver.errors import InputError
from ...solver.materials import MATERIALS, MaterialName
from . import fields, limits
from .choices import Contact, Deflection, Model, Scheme, Tip
from .fields import read_kn
from .flags import refuse
from .named import REPLACED, MeshFile, read_mesh_file
from .sources import material_damping_s
from .values import ANGLES, DropValues, Values


class Inputs(Values):
    """What a drop and a sweep share. SI units; angles in degrees.

    What is None in the command line's defaults is resolved here, so that a model holds everything
    that its run depends on.
    """

    @model_validator(mode="before")
    @classmethod
    def _resolve(cls, data: Any) -> Any:
        """Fill in what depends on other options."""
        if not isinstance(data, dict):
            return data
        data = dict(data)
        _resolve_shape(data)
        resolve_material(data)
        poisson = data.get("poisson", paper.POISSON)
        if isinstance(poisson, float) and -1.0 < poisson < 0.5:
            fill_in(data, kt_ratio=mindlin_ratio(poisson))
        if data.get("contact") == Contact.NITSCHE:
            fill_in(data, theta=1)
        if data.get("scheme") == Scheme.GENERALISED:
            fill_in(data, rho_inf=fields.RHO_INF)
        return data

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        """Refuse options that contradict each other, and what this version cannot do."""
        if self.diameter_m is not None:
            for field in ("width_m", "thickness_m"):
                if getattr(self, field) is not None:
                    refuse(field, "a round wire has a --diameter and neither width nor thickness")
        if 0.0 < self.alpha_1_s < limits.ALPHA_1_S:
            refuse("alpha_1_s", f"less than {limits.ALPHA_1_S:g} 1/s is lost in round-off; take 0")
        for field in ("theta", "gamma0"):
            if getattr(self, field) is not None and self.contact is not Contact.NITSCHE:
                refuse(field, "belongs to --contact nitsche")
        if self.rho_inf is not None and self.scheme is not Scheme.GENERALISED:
            refuse("rho_inf", "belongs to --scheme generalised")
        self._check_tip()
        limits.check_lean(self)
        return self

    def _check_tip(self) -> None:
        """Refuse an end face that is no face, or does not fit on the section."""
        if self.tip_shape == fields.FLAT:
            return
        if self.mesh is not None:
            refuse("tip_shape", "excluded by --mesh, whose tip has the shape of its facets")
        if self.tip is Tip.POINT:
            refuse("tip_shape", "a tip that touches with a point has no face; take --tip face")
        try:
            self.face().offset_m([0.0], [0.0], self.end_section())
        except ValueError as error:
            refuse("tip_shape", str(error))

    def check_meshed(self) -> None:
        """Refuse what the solid cannot be or cannot do."""
        if self.tip is Tip.POINT:
            refuse("tip", "the solid meets the surface with its face; point is for --model beam")
        try:
            self.shape()
        except ValueError as error:
            refuse("cells", str(error))
        limits.check_unknowns(self)


class MeshInputs(Inputs):
    """A mesh alone; what does not concern it keeps its default."""

    @model_validator(mode="after")
    def _meshable(self) -> Self:
        self.check_meshed()
        return self


class DropInputs(Inputs, DropValues):
    """One drop: every option of `bristle drop`, resolved and checked."""

    @model_validator(mode="before")
    @classmethod
    def _stabilise(cls, data: Any) -> Any:
        """Fill in what depends on the stiffness, and the model of a mesh."""
        if not isinstance(data, dict):
            return data
        data = dict(data)
        if data.get("mesh") is not None:
            fill_in(data, model=Model.REDUCED)
        if data.get("contact") == Contact.NITSCHE:
            rigid = read_kn(data.get("kn_N_m")) == math.inf
            fill_in(data, gamma0=GAMMA0_RIGID if rigid else GAMMA0)
        return data

    @model_validator(mode="after")
    def _possible(self) -> Self:
        """Refuse what no run could give a sensible answer to."""
        if self.mesh is not None and not self.model.meshed:
            refuse("model", f"{self.model} has no use for --mesh; take reduced or solid")
        if math.isinf(self.kn_N_m) and self.contact is Contact.PENALTY:
            refuse(
                "kn_N_m", "penalty needs a finite stiffness; take --contact nitsche or augmented"
            )
        if limits.KN_N_M < self.kn_N_m < math.inf:
            refuse("kn_N_m", f"above {limits.KN_N_M:g} N/m take inf, with nitsche or augmented")
        if self.model is Model.ANALYTIC:
            self._check_analytic()
        if self.model.meshed:
            self.check_meshed()
        if self.deflection is Deflection.SECOND_ORDER and not self.may_bend:
            refuse(
                "deflection",
                "second-order is for the beam and the reduced solid, under --scheme average, with "
                "penalty or augmented at a finite --kn",
            )
        if self.deflection is Deflection.FINITE and not self.may_turn:
            refuse(
                "deflection",
                "finite is for the solid, under --scheme average, with any --solver but iterative",
            )
        check_effects(self)
        limits.check_drop(self)
        return self

    def _check_analytic(self) -> None:
        only = "the analytic model is a mass on a spring without loss"
        plain = {
            "contact": (Contact.PENALTY, "it has penalty contact only"),
            "scheme": (Scheme.AVERAGE, "it has no time scheme"),
            "alpha_1_s": (0.0, "it has no damping"),
            **dict.fromkeys(ANGLES, (0.0, "it falls upright on a level surface")),
            "tip_shape": (fields.FLAT, "it has no end face"),
        }
        for field, (value, why) in plain.items():
            if getattr(self, field) != value:
                refuse(field, f"{only}: {why}")


def _resolve_shape(data: dict[str, Any]) -> None:
    """Fill in the bristle's measures and its division, unless it has a mesh of its own."""
    if data.get("mesh") is not None:
        for field in REPLACED:
            if data.get(field) is not None:
                refuse(field, "excluded by --mesh, which says it itself")
        return
    resolve_measures(data)
    flat = data.get("diameter_m") is None
    fill_in(data, cells=fields.CELLS, grading=1.0, geometry_order=1 if flat else 2)


def resolve_measures(data: dict[str, Any]) -> None:
    """Fill in the paper's bristle where measures are missing."""
    fill_in(data, length_m=paper.LENGTH_M)
    if data.get("diameter_m") is None:
        fill_in(data, width_m=paper.WIDTH_M, thickness_m=paper.THICKNESS_M)


def resolve_material(data: dict[str, Any]) -> None:
    """Fill in what a material by name is like."""
    if data.get("material") not in tuple(MaterialName):
        return
    material = MATERIALS[MaterialName(data["material"])]
    names = ("youngs_Pa", "poisson", "density_kg_m3")
    fill_in(data, **{name: getattr(material, name) for name in names})
    length_m = data.get("length_m")
    try:
        if isinstance(file := read_mesh_file(data.get("mesh")), MeshFile):
            length_m = file.read().length_m
    except ValueError as error:
        refuse("mesh", str(error))
    beta_s = material_damping_s(data, length_m)
    if beta_s is not None:
        fill_in(data, beta_s=beta_s)


def fill_in(data: dict[str, Any], **values: Any) -> None:
    """Set those of the ``values`` that ``data`` does not have."""
    data |= {key: value for key, value in values.items() if data.get(key) is None}


def check_effects(inputs: DropValues) -> None:
    """Refuse effects that the model, the enforcement or the scheme cannot have."""
    scene = inputs.scene()
    try:
        effects = [each.effect() for each in inputs.effects]
        after = enter_all(scene, effects)
    except InputError as error:
        refuse("effects", str(error))
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
