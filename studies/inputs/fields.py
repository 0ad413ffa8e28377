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
from .flags import Fields, Option, flags_of, several
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
    except (TypeError, ValueError):
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
PLUGIN = Option(
    "A Python file with effects of your own, repeatable; docs/examples/my_effect.py is one.",
    "FILE.py",
    kind=list,
    name="plugin",
    group=OUTPUT,
)
Plugins = Annotated[tuple[PluginFile, ...], BeforeValidator(read_plugins), PLUGIN]


class BodyFields(Fields, group=BODY):
    """Measures of the bristle."""

    length_m: Annotated[
        Annotated[float, between(1e-4, 100.0)] | None,
        Option("Length of the bristle.", shown=f"{paper.LENGTH_M:g}"),
    ] = None
    width_m: Annotated[
        Size | None, Option("Wide side of a flat wire.", shown=f"{paper.WIDTH_M:g}")
    ] = None
    thickness_m: Annotated[
        Size | None, Option("Thin side of a flat wire.", shown=f"{paper.THICKNESS_M:g}")
    ] = None
    diameter_m: Annotated[
        Size | None, Option("A round wire instead; excludes --width and --thickness.")
    ] = None


class MeshFileField(Fields, group=BODY):
    """A bristle of any shape."""

    mesh: Annotated[
        MeshFile | None,
        BeforeValidator(read_mesh_file),
        Option(
            "A bristle of any shape instead, for the models reduced (then the default) and solid: "
            "gmsh's mesh of hexahedra or tetrahedra in metres, upright along z, the facets that "
            "may touch in a physical group 'tip'. Excludes --length, --width, --thickness, "
            "--diameter, --cells, --grading, --geometry-order and --tip-shape.",
            "FILE.msh",
            kind=str,
        ),
    ] = None


class MaterialFields(Fields, group=BODY):
    """Elasticity, density and Rayleigh damping."""

    material: Annotated[
        MaterialName | None,
        Option(
            "Typical --youngs, --poisson, --density and --beta of a material, each unless it is "
            "given: steel is the paper's; the others have their loss factor in the first axial "
            "mode.",
            "|".join(MaterialName),
            "the paper's steel",
        ),
    ] = None
    youngs_Pa: Annotated[float, between(1e3, 1e14), Option("Young's modulus.")] = paper.YOUNGS_PA
    poisson: Annotated[float, between(-0.99, 0.4999), Option("Poisson's ratio.", "NU")] = (
        paper.POISSON
    )
    density_kg_m3: Annotated[float, between(0.1, 1e6), Option("Density.")] = paper.DENSITY_KG_M3
    beta_s: Annotated[
        float,
        between(0.0, 1.0),
        Option("Rayleigh damping of the material in proportion to its stiffness."),
    ] = paper.BETA_S
    alpha_1_s: Annotated[
        float, between(0.0, 1e6), Option("Rayleigh damping in proportion to its mass.")
    ] = paper.ALPHA_1_S


class MeshFields(Fields, group=MESH):
    """The mesh of hexahedra."""

    cells: Annotated[
        tuple[Count, Count, Count] | None,
        Option(
            "Hexahedra across the thickness, across the width and along the bristle. Round wire: "
            "along each side of the core, in the ring around it, along the bristle.",
            "NX NY NZ",
            " ".join(map(str, CELLS)),
        ),
    ] = None
    geometry_order: Annotated[
        Degree | None,
        Option("1: straight cell edges; 2: curved ones.", "1|2", "1; 2 for a round wire"),
    ] = None
    grading: Annotated[
        Ratio | None,
        Option("Length of the cell at the top over that at the tip.", "RATIO", "1"),
    ] = None


class DiscretisationFields(MeshFields, group=MESH):
    """Finite elements, and what solves their equations."""

    elements: Annotated[int, whole(1, 1000), Option("Elements of the beam.", "N")] = paper.ELEMENTS
    order: Annotated[Degree, Option("Polynomial degree of the solid.", "1|2")] = 2
    solver: Annotated[
        Solver,
        Option(
            "How the solid's equations are solved: auto is direct as long as factors take less "
            "than 8 GB; snes is Newton's method on the assembled form of a whole step, contact "
            "included, as a reference."
        ),
    ] = Solver.AUTO
    modes: Annotated[
        int,
        whole(1, 1000),
        Option(
            "Krylov vectors of the reduced solid to begin with; it takes up to eight times as many "
            "where its error asks, as long as they fill less than 1 GB.",
            "N",
        ),
    ] = MODES
    reduction_tolerance: Annotated[
        float,
        above_zero(1.0),
        Option(
            "Largest error of the reduced solid against the full order, in units of the impact "
            "speed."
        ),
    ] = REDUCTION_TOLERANCE


class ContactFields(Fields, group=CONTACT):
    """What meets the surface, and how contact is enforced."""

    contact: Annotated[Contact, Option("How contact is enforced.")] = Contact.PENALTY
    deflection: Annotated[
        Deflection | None,
        Option(
            "small: linear bodies. second-order: the axial force acts on the slope, as in a "
            "column, for beam and reduced under the average acceleration. finite: strain and "
            "rotation of any size, for the solid.",
            shown="where it leans: finite for the solid, else second-order up to 10 degrees",
            group=MODEL,
        ),
    ] = None
    friction: Annotated[
        float,
        between(0.0, 100.0),
        Option(
            "Coulomb's coefficient. It acts where bristle or surface leans or the tip is not flat; "
            "a flat tip that lands upright on a level surface does not slide, and friction is left "
            "out there.",
            "MU",
        ),
    ] = paper.FRICTION
    kt_ratio: Annotated[
        Ratio | None,
        Option(
            "Tangential over normal contact stiffness, where there is friction.",
            "RATIO",
            f"{KT_RATIO:.4g} for steel, Mindlin's 2(1-nu)/(2-nu)",
        ),
    ] = None
    tip: Annotated[
        Tip,
        Option(
            "The end section meets the surface point by point, or, as in the paper, with one node "
            "on the axis (beam only; right for upright drops alone)."
        ),
    ] = Tip.FACE
    tip_shape: Annotated[
        str,
        BeforeValidator(read_tip_shape),
        Option(
            "The end face: flat, chamfer:width=M,angle=DEG, rounded:radius=M, or "
            "worn:angle=DEG,direction=DEG, standing back most toward that direction from the thin "
            "side. It shifts where contact points stand, for the gap alone: the body keeps its "
            "mass and stiffness, and the solid its flat mesh.",
            "SHAPE",
        ),
    ] = FLAT
    contact_points: Annotated[
        int,
        whole(3, MOST_CONTACT_POINTS),
        Option(
            "Points across each side of the end section that can touch, its edges among them; the "
            "solid has at least as many.",
            "N",
        ),
    ] = CONTACT_POINTS
    theta: Annotated[
        Annotated[int, whole(-1, 1)] | None,
        Option("Nitsche's variant: 1 symmetric, 0 incomplete, -1 skew.", "1|0|-1", "1"),
    ] = None
    gamma0: Annotated[
        Annotated[float, above_zero(1e6)] | None,
        Option("Nitsche's stabilisation.", "NUMBER", "10, or 2 on a rigid plane"),
    ] = None


class PlaceFields(Fields, group=DROP):
    """How bristle and surface stand, and what else acts."""

    gravity_m_s2: Annotated[float, between(1e-4, 1e4), Option("Gravity.")] = paper.GRAVITY_M_S2
    tilt_deg: Annotated[
        Tilt,
        Option("How far the bristle's upper end leans toward its thin side, from vertical."),
    ] = 0.0
    tilt_wide_deg: Annotated[Tilt, Option("The same toward its wide side.")] = 0.0
    slope_deg: Annotated[
        Slope,
        Option("How far the surface's normal leans toward the thin side, from vertical."),
    ] = 0.0
    slope_wide_deg: Annotated[Slope, Option("The same toward the wide side.")] = 0.0
    until: Annotated[
        Until | float,
        BeforeValidator(read_until),
        Option(
            "Where to stop: after the first impact, after the rebound, or a time after release.",
            "impact|rebound|SECONDS",
            kind=str,
        ),
    ] = Until.REBOUND
    plugins: Plugins = ()  # before the effects that may come from them
    effects: Annotated[
        tuple[EffectInput, ...],
        BeforeValidator(read_effects),
        Option(
            "A further piece of physics, repeatable, e.g. contact_damping:c_N_s_m=5; what differs "
            "from drop to drop stands one standard deviation out.",
            "NAME:PARAM=VALUE,…",
            kind=list,
            name="effect",
        ),
    ] = ()


class TimeFields(Fields, group=TIME):
    """The time scheme."""

    scheme: Annotated[
        Scheme,
        Option(
            "average conserves energy in contact; newmark is the average acceleration with contact "
            "at the end of the step; generalised is generalised-alpha."
        ),
    ] = Scheme.AVERAGE
    rho_inf: Annotated[
        Annotated[float, between(0.0, 1.0)] | None,
        Option(
            "Spectral radius of generalised-alpha at infinite frequency.", "0…1", f"{RHO_INF:g}"
        ),
    ] = None
    march: Annotated[
        Truth,
        Option(
            "March all of the drop at ITS, to check the exact flight between impacts. Rotation is "
            "linearised about the release, so a leaning bristle is right only while it has turned "
            "little."
        ),
    ] = False


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

    its_s: Annotated[Its, Option("Integration time step.")] = paper.ITS_S


class DropFields(Fields):
    """Model, stiffness and height of one drop, and its output."""

    model: Annotated[
        Model,
        Option(
            "reduced: the 3-D solid in few unknowns; solid: at full order; beam; analytic: a mass "
            "on a spring.",
            group=MODEL,
        ),
    ] = Model.REDUCED
    kn_N_m: Annotated[
        Kn, Option("Normal contact stiffness; 'inf' with nitsche and augmented.", group=CONTACT)
    ] = paper.KN_CHOSEN_N_M
    height_m: Annotated[Height, Option("Height of the lower tip over the surface.", group=DROP)] = (
        paper.HEIGHTS_M[-1]
    )
    write_fields: Annotated[
        Truth,
        Option(
            "ParaView output of the solid, which it has unless --no-fields.",
            name="fields",
            group=OUTPUT,
        ),
    ] = True
    write_every: Annotated[
        Annotated[int, whole(1, 1_000_000)] | None,
        Option(
            "Steps from one instant of the ParaView output to the next.",
            "N",
            "40 instants in 2L/c",
            group=OUTPUT,
        ),
    ] = None


class HeightsField(Fields, group=DROP):
    """Several heights."""

    heights_m: Annotated[
        tuple[Height, ...],
        Numbers,
        Field(min_length=1),
        Option("Heights, separated by commas.", "M,…", "", str, alias="--height"),
    ] = paper.HEIGHTS_M


class ListFields(Fields):
    """Several models, stiffnesses and time steps."""

    models: Annotated[
        tuple[Model, ...],
        BeforeValidator(read_list),
        Option("Models, separated by commas.", "MODEL,…", "", str, group=MODEL, alias="--model"),
    ] = (Model.BEAM, Model.REDUCED)
    kn_N_m: Annotated[
        tuple[Kn, ...],
        Numbers,
        Option("Normal contact stiffnesses, separated by commas.", "N/M,…", "", str, group=CONTACT),
    ] = paper.KN_N_M
    its_s: Annotated[
        tuple[Its, ...],
        Numbers,
        Option("Integration time steps, separated by commas.", "S,…", "", str, group=TIME),
    ] = (paper.ITS_S,)


DROP_FLAGS = flags_of(DropFields, StepField, SharedFields)
LIST_FLAGS = flags_of(ListFields, HeightsField)
SHARED_FLAGS = flags_of(SharedFields)
STUDY_FLAGS = (*LIST_FLAGS, *SHARED_FLAGS)
SWEEP_FLAGS = (*LIST_FLAGS, *several(SHARED_FLAGS))
