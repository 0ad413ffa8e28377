"""Inputs of a drop and of sweeps: type, bounds, unit, default and help of each, declared once.

SI units, angles in degrees; the unit is the end of a field's name. `config` adds what inputs have
to do with each other and makes the solver's objects of them. Flags, keys of TOML files, `--help`
and keyword arguments in Python come from these fields. Nothing heavy is imported here.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ...solver import paper
from ...solver.materials import MaterialName
from .choices import Contact, Deflection, Model, Scheme, Solver, Tip, Until
from .flags import Fields, flags_of, option, several
from .named import (
    EffectInput,
    MeshFile,
    PluginFile,
    read_effects,
    read_mesh_file,
    read_plugins,
)

MODEL, CONTACT, BODY = "Model", "Contact", "Bristle"
DROP, TIME, MESH, OUTPUT = "Drop", "Time", "Discretisation", "Files"

CELLS = (1, 4, 337)
MODES = 40
REDUCTION_TOLERANCE = 1e-3
RHO_INF = 0.8
# solver.bristle.CONTACT_POINTS, which cannot be imported without numpy.
CONTACT_POINTS, MOST_CONTACT_POINTS = 9, 33
FLAT = "flat"
# Mindlin's 2(1-nu)/(2-nu), see solver.contact.laws.
KT_RATIO = 2.0 * (1.0 - paper.POISSON) / (2.0 - paper.POISSON)
LONGEST_S = 60.0


def read_kn(value: Any) -> Any:
    """A stiffness, infinity also as text, since JSON has no other way to write it."""
    return math.inf if value in ("inf", "Infinity") else value


def read_until(value: Any) -> Any:
    """`impact`, `rebound` or a time after release in s, also as text."""
    if isinstance(value, str) and value in tuple(Until):
        return Until(value)
    try:
        seconds = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        seconds = math.nan
    if not 0.0 < seconds <= LONGEST_S:
        raise ValueError(
            f"must be impact, rebound or a time in seconds up to {LONGEST_S:g}, not {value!r}"
        )
    return seconds


def read_tip_shape(value: Any) -> Any:
    """The shape of the end face as text, once it is one that `parse_tip_shape` knows."""
    if isinstance(value, str):
        from ...meshes.tip_shape import parse_tip_shape

        value = value.strip()
        parse_tip_shape(value)
    return value


def read_list(value: Any) -> Any:
    """Items of a text separated by commas, of a list, or one alone."""
    if isinstance(value, str):
        value = [item.strip() for item in value.split(",")]
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def read_numbers(value: Any) -> Any:
    """Numbers of a text separated by commas, of a list, or one alone."""
    return tuple(_number(item) for item in read_list(value))


def read_items(kind: type, value: Any) -> tuple[Any, ...]:
    """Each value once, of a text separated by commas, of a list or a range, or one alone; sorted
    numbers where ``kind`` is one. Raises ValueError for values of another kind."""
    items = read_list(list(value) if isinstance(value, range | set | frozenset) else value)
    number = issubclass(kind, int | float)
    if number:
        items = tuple(map(_number, items))
    if number and not all(type(each) in (int, float) for each in items):
        raise ValueError(f"must be numbers, not {value!r}")
    if not all(isinstance(each, int | float | str) for each in items):
        raise ValueError(f"must be words, not {value!r}")
    if kind is int:
        items = tuple(int(x) if math.isfinite(x) and x == int(x) else x for x in items)
    return tuple(dict.fromkeys(sorted(items) if number else items))


def _number(item: Any) -> Any:
    try:
        return float(item) if isinstance(item, str) else item
    except ValueError:
        raise ValueError(f"must be numbers separated by commas; '{item}' is none") from None


def between(low: float, high: float) -> Any:
    """A finite number from ``low`` to ``high``."""
    return Field(strict=True, ge=low, le=high, allow_inf_nan=False)


def whole(low: int, high: int) -> Any:
    """A whole number from ``low`` to ``high``."""
    return Field(strict=True, ge=low, le=high)


def above_zero(high: float) -> Any:
    """A positive number up to ``high``."""
    return Field(strict=True, gt=0.0, le=high, allow_inf_nan=False)


Count = Annotated[int, whole(1, 100_000)]
Degree = Annotated[int, whole(1, 2)]
Size = Annotated[float, between(1e-6, 1.0)]
Tilt = Annotated[float, between(-80.0, 80.0)]
Slope = Annotated[float, between(-60.0, 60.0)]
Kn = Annotated[float, Field(strict=True, ge=1e-3), BeforeValidator(read_kn)]
Height = Annotated[float, between(1e-7, 1e3)]
Its = Annotated[float, between(1e-12, 1.0)]
Ratio = Annotated[float, between(1e-6, 1e6)]
Truth = Annotated[bool, Field(strict=True)]
Numbers = BeforeValidator(read_numbers)
Heights = Annotated[tuple[Height, ...], Numbers, Field(min_length=1)]
Kns = Annotated[tuple[Kn, ...], Numbers, Field(min_length=1)]
Steps = Annotated[tuple[Its, ...], Numbers, Field(min_length=1)]
Models = Annotated[tuple[Model, ...], BeforeValidator(read_list), Field(min_length=1)]
Effects = Annotated[tuple[EffectInput, ...], BeforeValidator(read_effects)]
Plugins = Annotated[tuple[PluginFile, ...], BeforeValidator(read_plugins)]


def plugin_option() -> Any:
    """The option `--plugin`."""
    help = (
        "A Python file with effects or kinds of data of your own, repeatable; "
        "docs/examples/my_effect.py is one."
    )
    return option((), help, "FILE.py", kind=list, name="plugin", group=OUTPUT)


def effect_option(help: str) -> Any:
    """The option `--effect`."""
    return option((), help, "NAME:PARAM=VALUE,…", kind=list, name="effect")


def listed(default: tuple[Any, ...], help: str, metavar: str, **where: Any) -> Any:
    """An option of several values in one text; ``where`` is its group and a further spelling."""
    return option(default, f"{help}, separated by commas.", metavar, "", str, **where)


def kt_ratio_option(help: str) -> Any:
    """The option `--kt-ratio`."""
    shown = f"{KT_RATIO:.4g} for steel, Mindlin's 2(1-nu)/(2-nu)"
    return option(None, f"Tangential over normal contact stiffness{help}.", "RATIO", shown)


class BodyFields(Fields, group=BODY):
    """Measures of the bristle."""

    length_m: Annotated[float, between(1e-4, 100.0)] | None = option(
        None, "Length of the bristle.", shown=f"{paper.LENGTH_M:g}"
    )
    width_m: Size | None = option(None, "Wide side of a flat wire.", shown=f"{paper.WIDTH_M:g}")
    thickness_m: Size | None = option(
        None, "Thin side of a flat wire.", shown=f"{paper.THICKNESS_M:g}"
    )
    diameter_m: Size | None = option(
        None, "A round wire instead; excludes --width and --thickness."
    )


class MeshFileField(Fields, group=BODY):
    """A bristle of any shape."""

    mesh: Annotated[MeshFile | None, BeforeValidator(read_mesh_file)] = option(
        None,
        "A bristle of any shape instead, for the models reduced (then the default) and solid: "
        "gmsh's mesh of hexahedra or tetrahedra in metres, upright along z, the facets that "
        "may touch in a physical group 'tip'. Excludes --length, --width, --thickness, "
        "--diameter, --cells, --grading, --geometry-order and --tip-shape.",
        "FILE.msh",
        kind=str,
    )


class MaterialFields(Fields, group=BODY):
    """Elasticity, density and Rayleigh damping."""

    material: MaterialName | None = option(
        None,
        "Sets --youngs, --poisson, --density and --beta to typical values of a material. A value "
        "that you give wins. Steel is the paper's. The --beta of the others gives the first "
        "axial mode the loss factor of the material.",
        "|".join(MaterialName),
        "the paper's steel",
    )
    youngs_Pa: Annotated[float, between(1e3, 1e14)] = option(paper.YOUNGS_PA, "Young's modulus.")
    poisson: Annotated[float, between(-0.99, 0.4999)] = option(
        paper.POISSON, "Poisson's ratio.", "NU"
    )
    density_kg_m3: Annotated[float, between(0.1, 1e6)] = option(paper.DENSITY_KG_M3, "Density.")
    beta_s: Annotated[float, between(0.0, 1.0)] = option(
        paper.BETA_S, "Rayleigh damping of the material in proportion to its stiffness."
    )
    alpha_1_s: Annotated[float, between(0.0, 1e6)] = option(
        paper.ALPHA_1_S, "Rayleigh damping in proportion to its mass."
    )


class MeshFields(Fields, group=MESH):
    """The mesh of hexahedra."""

    cells: tuple[Count, Count, Count] | None = option(
        None,
        "Hexahedra across the thickness, across the width and along the bristle. Round wire: "
        "along each side of the core, in the ring around it, along the bristle.",
        "NX NY NZ",
        " ".join(map(str, CELLS)),
    )
    geometry_order: Degree | None = option(
        None, "1: straight cell edges; 2: curved ones.", "1|2", "1; 2 for a round wire"
    )
    grading: Ratio | None = option(
        None, "Length of the cell at the top over that at the tip.", "RATIO", "1"
    )


class DiscretisationFields(MeshFields, group=MESH):
    """Finite elements, and what solves their equations."""

    elements: Annotated[int, whole(1, 1000)] = option(paper.ELEMENTS, "Elements of the beam.", "N")
    order: Degree = option(2, "Polynomial degree of the solid.", "1|2")
    solver: Solver = option(
        Solver.AUTO,
        "How the solid's equations are solved: auto is direct if the factors take less than "
        "8 GB, else iterative.",
    )
    modes: Annotated[int, whole(1, 1000)] = option(
        MODES,
        "Krylov vectors of the reduced solid to begin with. If the estimated error is too large, "
        "their number is doubled, up to eight times the first number or 1 GB.",
        "N",
    )
    reduction_tolerance: Annotated[float, above_zero(1.0)] = option(
        REDUCTION_TOLERANCE,
        "Greatest estimated error of the reduced solid against the full order, in units of the "
        "impact speed.",
    )


class ContactFields(Fields, group=CONTACT):
    """What meets the surface, and how contact is enforced."""

    contact: Contact = option(Contact.PENALTY, "How contact is enforced.")
    deflection: Deflection | None = option(
        None,
        "small: the body is linear. second-order, for beam and reduced with --scheme average: "
        "the axial force also acts on the slope, as in a column that buckles. finite, for the "
        "solid: strain and rotation of any size.",
        shown="where it leans: finite for the solid, else second-order up to 10 degrees",
        group=MODEL,
    )
    friction: Annotated[float, between(0.0, 100.0)] = option(
        paper.FRICTION,
        "Coulomb's coefficient. It acts if the bristle or the surface leans, or if the tip is "
        "not flat. A flat tip that lands upright on a level surface does not slide, so friction "
        "is left out there.",
        "MU",
    )
    kt_ratio: Ratio | None = kt_ratio_option(", where there is friction")
    tip: Tip = option(
        Tip.FACE,
        "face: the end section touches the surface point by point. point: one node on the axis "
        "touches it, as in the paper (beam only; right for upright drops alone).",
    )
    tip_shape: Annotated[str, BeforeValidator(read_tip_shape)] = option(
        FLAT,
        "The end face: flat, chamfer:width=M,angle=DEG, rounded:radius=M, or "
        "worn:angle=DEG,direction=DEG. A worn face stands back most in its direction, an angle "
        "from the thin side. The shape moves the contact points only: mass, stiffness and mesh "
        "are those of a flat end.",
        "SHAPE",
    )
    contact_points: Annotated[int, whole(3, MOST_CONTACT_POINTS)] = option(
        CONTACT_POINTS,
        "Points across each side of the end section that can touch, edges included. The solid "
        "has at least as many.",
        "N",
    )
    theta: Annotated[int, whole(-1, 1)] | None = option(
        None, "Nitsche's variant: 1 symmetric, 0 incomplete, -1 skew.", "1|0|-1", "1"
    )
    gamma0: Annotated[float, above_zero(1e6)] | None = option(
        None, "Nitsche's stabilisation.", "NUMBER", "10, or 2 on a rigid plane"
    )


class PlaceFields(Fields, group=DROP):
    """How bristle and surface stand, and what else acts."""

    gravity_m_s2: Annotated[float, between(1e-4, 1e4)] = option(paper.GRAVITY_M_S2, "Gravity.")
    tilt_deg: Tilt = option(
        0.0, "How far the bristle's upper end leans toward its thin side, from vertical."
    )
    tilt_wide_deg: Tilt = option(0.0, "The same toward its wide side.")
    slope_deg: Slope = option(
        0.0, "How far the surface's normal leans toward the thin side, from vertical."
    )
    slope_wide_deg: Slope = option(0.0, "The same toward the wide side.")
    until: Annotated[Until | float, BeforeValidator(read_until)] = option(
        Until.REBOUND,
        "Where to stop: after the first impact, after the rebound, or a time after release.",
        "impact|rebound|SECONDS",
        kind=str,
    )
    plugins: Plugins = plugin_option()  # before the effects that may come from them
    effects: Effects = effect_option(
        "A further piece of physics, repeatable, e.g. contact_damping:c_N_s_m=5. "
        "docs/effects.md lists them. An effect that differs from drop to drop is taken at plus "
        "one standard deviation."
    )


class TimeFields(Fields, group=TIME):
    """The time scheme."""

    scheme: Scheme = option(
        Scheme.AVERAGE,
        "average conserves energy in contact; newmark is the average acceleration with contact "
        "at the end of the step; generalised is generalised-alpha.",
    )
    rho_inf: Annotated[float, between(0.0, 1.0)] | None = option(
        None, "Spectral radius of generalised-alpha at infinite frequency.", "0…1", f"{RHO_INF:g}"
    )


class SharedFields(
    DiscretisationFields,
    TimeFields,
    PlaceFields,
    MaterialFields,
    MeshFileField,
    BodyFields,
    ContactFields,
):
    """What a drop and a sweep share."""


class StepField(Fields, group=TIME):
    """The time step of one drop."""

    its_s: Its = option(paper.ITS_S, "Integration time step.")


class DropFields(Fields):
    """Model, stiffness and height of one drop, and its output."""

    model: Model = option(
        Model.REDUCED,
        "reduced: the 3-D solid in few unknowns; solid: the same at full order; beam; analytic: "
        "a mass on a spring.",
        group=MODEL,
    )
    kn_N_m: Kn = option(
        paper.KN_CHOSEN_N_M,
        "Normal contact stiffness. 'inf' is a rigid plane, for --contact nitsche and augmented.",
        group=CONTACT,
    )
    height_m: Height = option(
        paper.HEIGHTS_M[-1], "Height of the lower tip over the surface.", group=DROP
    )
    write_fields: Truth = option(
        True,
        "Fields of the solid for ParaView. They are written unless --no-fields.",
        name="fields",
        group=OUTPUT,
    )
    write_every: Annotated[int, whole(1, 1_000_000)] | None = option(
        None,
        "Time steps from one instant of the ParaView output to the next.",
        "N",
        "40 instants in 2L/c",
        group=OUTPUT,
    )


class HeightsField(Fields, group=DROP):
    """Several heights."""

    heights_m: Heights = listed(paper.HEIGHTS_M, "Heights", "M,…", alias="--height")


class ListFields(Fields):
    """Several models, stiffnesses and time steps."""

    models: Models = listed(
        (Model.BEAM, Model.REDUCED), "Models", "MODEL,…", group=MODEL, alias="--model"
    )
    kn_N_m: Kns = listed(paper.KN_N_M, "Normal contact stiffnesses", "N/M,…", group=CONTACT)
    its_s: Steps = listed((paper.ITS_S,), "Integration time steps", "S,…", group=TIME)


DROP_FLAGS = flags_of(DropFields, StepField, SharedFields)
LIST_FLAGS = flags_of(ListFields, HeightsField)
SHARED_FLAGS = flags_of(SharedFields)
MESH_FLAGS = flags_of(BodyFields, MeshFields)
STUDY_FLAGS = (*LIST_FLAGS, *SHARED_FLAGS)
SWEEP_FLAGS = (*LIST_FLAGS, *several(SHARED_FLAGS))
