"""Which options does the command line have, and what does --help say of each?

Nothing heavy is imported here, so that help is quick. Values are checked by `config`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from ...solver import paper
from .choices import Contact, Deflection, Model, Scheme, Solver, Tip

MODEL, CONTACT, BODY = "Model", "Contact", "Bristle"
DROP, TIME, MESH, OUTPUT = "Drop", "Time", "Discretisation", "Files"

CELLS = (1, 4, 337)
MODES = 40
REDUCTION_TOLERANCE = 1e-3
RHO_INF = 0.8
# solver.bristle.CONTACT_POINTS, which cannot be imported without numpy.
CONTACT_POINTS = 9
FLAT = "flat"
# Mindlin's 2(1-nu)/(2-nu), see solver.contact.laws.
KT_RATIO = 2.0 * (1.0 - paper.POISSON) / (2.0 - paper.POISSON)


@dataclass(frozen=True)
class Flag:
    """One option: ``name`` without dashes, ``field`` of the inputs that it sets, its default.

    ``kind`` is what the command line parses: a type, an enum, or a tuple of types. A default of
    None means that another option decides; ``shown`` then says what comes of it.
    """

    name: str
    field: str
    kind: Any
    default: Any
    group: str
    help: str
    metavar: str | None = None
    shown: str | None = None
    alias: str | None = None

    @property
    def option(self) -> str:
        return f"--{self.name}"

    @property
    def parameter(self) -> str:
        return self.name.replace("-", "_")

    def default_text(self) -> str:
        """The default as help shows it, or an empty text."""
        if self.shown is not None or self.default is None:
            return self.shown or ""
        if isinstance(self.default, tuple):
            return " ".join(map(str, self.default))
        if isinstance(self.default, bool):
            return ""
        if isinstance(self.default, StrEnum):
            return self.default.value
        return f"{self.default:g}" if isinstance(self.default, float) else str(self.default)


BODY_FLAGS = (
    Flag("length", "length_m", float, paper.LENGTH_M, BODY, "Length of the bristle.", "M"),
    Flag(
        "width",
        "width_m",
        float,
        None,
        BODY,
        "Wide side of a flat wire.",
        "M",
        f"{paper.WIDTH_M:g}",
    ),
    Flag(
        "thickness",
        "thickness_m",
        float,
        None,
        BODY,
        "Thin side of a flat wire.",
        "M",
        f"{paper.THICKNESS_M:g}",
    ),
    Flag(
        "diameter",
        "diameter_m",
        float,
        None,
        BODY,
        "A round wire instead; excludes --width and --thickness.",
        "M",
    ),
)
MESH_FILE_FLAG = Flag(
    "mesh",
    "mesh",
    str,
    None,
    BODY,
    "A bristle of any shape instead, for the models reduced (then the default) and solid: gmsh's "
    "mesh of hexahedra or tetrahedra in metres, upright along z, the facets that may touch in a "
    "physical group 'tip'. Excludes --length, --width, --thickness, --diameter, --cells, "
    "--grading, --geometry-order and --tip-shape.",
    "FILE.msh",
)
MATERIAL_FLAGS = (
    Flag("youngs", "youngs_Pa", float, paper.YOUNGS_PA, BODY, "Young's modulus.", "PA"),
    Flag("poisson", "poisson", float, paper.POISSON, BODY, "Poisson's ratio.", "NU"),
    Flag("density", "density_kg_m3", float, paper.DENSITY_KG_M3, BODY, "Density.", "KG/M3"),
    Flag(
        "beta",
        "beta_s",
        float,
        paper.BETA_S,
        BODY,
        "Rayleigh damping of the material in proportion to its stiffness.",
        "S",
    ),
    Flag(
        "alpha",
        "alpha_1_s",
        float,
        paper.ALPHA_1_S,
        BODY,
        "Rayleigh damping in proportion to its mass.",
        "1/S",
    ),
)
MESH_FLAGS = (
    Flag(
        "cells",
        "cells",
        (int, int, int),
        CELLS,
        MESH,
        "Hexahedra across the thickness, across the width and along the bristle. Round wire: "
        "along each side of the core, in the ring around it, along the bristle.",
        "NX NY NZ",
    ),
    Flag(
        "geometry-order",
        "geometry_order",
        int,
        None,
        MESH,
        "1: straight cell edges; 2: curved ones.",
        "1|2",
        "1; 2 for a round wire",
    ),
    Flag(
        "grading",
        "grading",
        float,
        1.0,
        MESH,
        "Length of the cell at the top over that at the tip.",
        "RATIO",
    ),
)
DISCRETISATION_FLAGS = (
    Flag("elements", "elements", int, paper.ELEMENTS, MESH, "Elements of the beam.", "N"),
    *MESH_FLAGS,
    Flag("order", "order", int, 2, MESH, "Polynomial degree of the solid.", "1|2"),
    Flag(
        "solver",
        "solver",
        Solver,
        Solver.AUTO,
        MESH,
        "How the solid's equations are solved: auto is direct as long as factors take less than "
        "8 GB; snes is Newton's method on the assembled form of a whole step, contact included, as "
        "a reference.",
    ),
    Flag(
        "modes",
        "modes",
        int,
        MODES,
        MESH,
        "Krylov vectors of the reduced solid to begin with; it takes more where its error asks.",
        "N",
    ),
    Flag(
        "reduction-tolerance",
        "reduction_tolerance",
        float,
        REDUCTION_TOLERANCE,
        MESH,
        "Largest error of the reduced solid against the full order, in units of the impact speed.",
    ),
)
CONTACT_FLAGS = (
    Flag("contact", "contact", Contact, Contact.PENALTY, CONTACT, "How contact is enforced."),
    Flag(
        "deflection",
        "deflection",
        Deflection,
        None,
        MODEL,
        "small: linear bodies. second-order: the axial force acts on the slope, as in a column, "
        "for beam and reduced under the average acceleration. finite: strain and rotation of any "
        "size, for the solid.",
        shown="where it leans: finite for the solid, else second-order up to 10 degrees",
    ),
    Flag(
        "friction",
        "friction",
        float,
        paper.FRICTION,
        CONTACT,
        "Coulomb's coefficient. It acts where bristle or surface leans or the tip is not flat; a "
        "flat tip that lands upright on a level surface does not slide, and friction is left out "
        "there.",
        "MU",
    ),
    Flag(
        "kt-ratio",
        "kt_ratio",
        float,
        None,
        CONTACT,
        "Tangential over normal contact stiffness, where there is friction.",
        "RATIO",
        f"{KT_RATIO:.4g} for steel, Mindlin's 2(1-nu)/(2-nu)",
    ),
    Flag(
        "tip",
        "tip",
        Tip,
        Tip.FACE,
        CONTACT,
        "The end section meets the surface point by point, or, as in the paper, with one node on "
        "the axis (beam only; right for upright drops alone).",
    ),
    Flag(
        "tip-shape",
        "tip_shape",
        str,
        FLAT,
        CONTACT,
        "The end face: flat, chamfer:width=M,angle=DEG, rounded:radius=M, or "
        "worn:angle=DEG,direction=DEG, standing back most toward that direction from the thin "
        "side. It shifts where contact points stand, for the gap alone: the body keeps its mass "
        "and stiffness, and the solid its flat mesh.",
        "SHAPE",
    ),
    Flag(
        "contact-points",
        "contact_points",
        int,
        CONTACT_POINTS,
        CONTACT,
        "Points across each side of the end section that can touch, its edges among them; the "
        "solid has at least as many.",
        "N",
    ),
    Flag(
        "theta",
        "theta",
        int,
        None,
        CONTACT,
        "Nitsche's variant: 1 symmetric, 0 incomplete, -1 skew.",
        "1|0|-1",
        "1",
    ),
    Flag(
        "gamma0",
        "gamma0",
        float,
        None,
        CONTACT,
        "Nitsche's stabilisation.",
        "NUMBER",
        "10, or 2 on a rigid plane",
    ),
)
PLACE_FLAGS = (
    Flag("gravity", "gravity_m_s2", float, paper.GRAVITY_M_S2, DROP, "Gravity.", "M/S2"),
    Flag(
        "tilt",
        "tilt_deg",
        float,
        0.0,
        DROP,
        "How far the bristle's upper end leans toward its thin side, from vertical.",
        "DEGREES",
    ),
    Flag(
        "tilt-wide",
        "tilt_wide_deg",
        float,
        0.0,
        DROP,
        "The same toward its wide side.",
        "DEGREES",
    ),
    Flag(
        "slope",
        "slope_deg",
        float,
        0.0,
        DROP,
        "How far the surface's normal leans toward the thin side, from vertical.",
        "DEGREES",
    ),
    Flag(
        "slope-wide",
        "slope_wide_deg",
        float,
        0.0,
        DROP,
        "The same toward the wide side.",
        "DEGREES",
    ),
    Flag(
        "until",
        "until",
        str,
        "rebound",
        DROP,
        "Where to stop: after the first impact, after the rebound, or a time after release.",
        "impact|rebound|SECONDS",
    ),
    Flag(
        "effect",
        "effects",
        list,
        (),
        DROP,
        "A further piece of physics, repeatable, e.g. contact_damping:c_N_s_m=5; what differs from "
        "drop to drop stands one standard deviation out.",
        "NAME:PARAM=VALUE,…",
    ),
)
TIME_FLAGS = (
    Flag(
        "scheme",
        "scheme",
        Scheme,
        Scheme.AVERAGE,
        TIME,
        "average conserves energy in contact; newmark is the average acceleration with contact at "
        "the end of the step; generalised is generalised-alpha.",
    ),
    Flag(
        "rho-inf",
        "rho_inf",
        float,
        None,
        TIME,
        "Spectral radius of generalised-alpha at infinite frequency.",
        "0…1",
        f"{RHO_INF:g}",
    ),
    Flag(
        "march",
        "march",
        bool,
        False,
        TIME,
        "March all of the drop at ITS, to check the exact flight between impacts. Rotation is "
        "linearised about the release, so a leaning bristle is right only while it has turned "
        "little.",
    ),
)
FIELD_FLAGS = (
    Flag(
        "fields",
        "write_fields",
        bool,
        True,
        OUTPUT,
        "ParaView output of the solid, which it has unless --no-fields.",
    ),
    Flag(
        "write-every",
        "write_every",
        int,
        None,
        OUTPUT,
        "Steps from one instant of the ParaView output to the next.",
        "N",
        "40 instants in 2L/c",
    ),
)
MODEL_FLAG = Flag(
    "model",
    "model",
    Model,
    Model.REDUCED,
    MODEL,
    "reduced: the 3-D solid in few unknowns; solid: at full order; beam; analytic: a mass on a "
    "spring.",
)
KN_FLAG = Flag(
    "kn",
    "kn_N_m",
    float,
    paper.KN_CHOSEN_N_M,
    CONTACT,
    "Normal contact stiffness; 'inf' with nitsche and augmented.",
    "N/M",
)
HEIGHT_FLAG = Flag(
    "height",
    "height_m",
    float,
    paper.HEIGHTS_M[-1],
    DROP,
    "Height of the lower tip over the surface.",
    "M",
)
ITS_FLAG = Flag("its", "its_s", float, paper.ITS_S, TIME, "Integration time step.", "S")

SHARED_FLAGS = (
    *CONTACT_FLAGS,
    *BODY_FLAGS,
    MESH_FILE_FLAG,
    *MATERIAL_FLAGS,
    *PLACE_FLAGS,
    *TIME_FLAGS,
    *DISCRETISATION_FLAGS,
)
DROP_FLAGS = (MODEL_FLAG, KN_FLAG, HEIGHT_FLAG, ITS_FLAG, *SHARED_FLAGS, *FIELD_FLAGS)

LISTS_FLAGS = (
    Flag(
        "models",
        "models",
        str,
        None,
        MODEL,
        "Models, separated by commas.",
        "MODEL,…",
        alias="--model",
    ),
    Flag(
        "kn",
        "kn_N_m",
        str,
        None,
        CONTACT,
        "Normal contact stiffnesses, separated by commas.",
        "N/M,…",
    ),
    Flag(
        "heights",
        "heights_m",
        str,
        None,
        DROP,
        "Heights, separated by commas.",
        "M,…",
        alias="--height",
    ),
    Flag("its", "its_s", str, None, TIME, "Integration time steps, separated by commas.", "S,…"),
)
