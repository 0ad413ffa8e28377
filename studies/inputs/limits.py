"""Limits of what can be meant by a run, and warnings about what deserves doubt."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel

from ...meshes.section import Rectangle
from ...solver import paper
from ...solver.analytic import quarter_period_s
from ...solver.arrays import Array
from ...solver.bristle import Bristle
from ...solver.drop import DropResult
from ...solver.energy import ASTRAY
from ...solver.errors import ComputationError
from ...solver.fall import free_fall
from .choices import Contact, Deflection, Model, Scheme, Tip, Until
from .fields import FLAT, MOST_CONTACT_POINTS
from .flags import refuse
from .sources import OPTIONS
from .values import ANGLES, LINEAR_LEAN_DEG, DropValues, Values

UNKNOWNS = 10_000_000
STEPS = 2_000_000
# Far above any tip's own stiffness; beyond it a penetration is lost in the rounding of heights.
KN_N_M = 1e12
# An impact of fewer steps than one in ten is none at all.
LONGEST_STEP = 10.0
# Damped free fall differs from undamped by less than its rounding below this.
ALPHA_1_S = 1e-3
# Times gravity: a deceleration by the spring below which damping keeps the bristle on it.
REST = 20.0
# Speed of the impact over that of axial waves.
STRAIN = 0.1
CLOSURE = 1e-6
# Of a body that bends or turns by more than is small: what the change to linear flight leaves over.
CLOSURE_BENT = 1e-2
# Lean from which a linear body is off by more than a hundredth of the speed (tests/reference).
SMALL_LEAN_DEG = 0.5
# Angular velocity over the slowest bending's: what turning does to ringing is left out of flight.
SPIN = 0.1
# What bristles are, SI, and by what to multiply a value that was meant in another unit.
MILLIMETRES = {"mm": 1e-3}
USUAL: dict[str, tuple[float, float, dict[str, float]]] = {
    "length_m": (5e-3, 2.0, MILLIMETRES),
    "width_m": (1e-5, 2e-2, MILLIMETRES),
    "thickness_m": (1e-5, 2e-2, MILLIMETRES),
    "diameter_m": (1e-5, 2e-2, MILLIMETRES),
    "height_m": (1e-5, 10.0, MILLIMETRES),
    "youngs_Pa": (1e7, 1.2e12, {"MPa": 1e6, "GPa": 1e9}),
    "density_kg_m3": (200.0, 2.5e4, {"g/cm³": 1e3}),
    "kn_N_m": (1e2, 1e12, {"MN/m": 1e6, "N/mm": 1e3}),
}
# Of the first axial mode, over critical.
MOST_DAMPED = 30.0
# Elastic constants this close to the steel's are another steel's.
ALIKE = 0.1
# Lean at which the side or the upper end reaches the surface.
FALLEN_DEG = 90.0
# Bristle against the surface's normal; beyond it the side touches before the end face.
LEAN_DEG = 80.0
# First root of cos x cosh x = 1: the slowest bending of a free bar.
FREE_BENDING = 4.730040744862704


def count_unknowns(inputs: Values) -> int:
    """Unknowns of the solid, exactly but for a round wire."""
    p = inputs.order
    if inputs.mesh is not None:
        return 3 * inputs.mesh.read().n_nodes(p)
    spec = inputs.mesh_spec()
    section, (nx, ny, nz) = spec.n_section_cells, spec.cells
    if inputs.diameter_m is None:
        nodes = (p * nx + 1) * (p * ny + 1)
    else:
        nodes = p * p * section + 2 * p * nx + 1
    return 3 * nodes * (p * nz + 1)


def check_unknowns(inputs: Values) -> None:
    """Refuse a solid of more than ``UNKNOWNS``."""
    n = count_unknowns(inputs)
    if n > UNKNOWNS:
        field, cells = ("cells", " ".join(map(str, inputs.cells or ())))
        if inputs.mesh is not None:
            field, cells = "mesh", f"the cells of {inputs.mesh.path}"
        refuse(field, f"{cells} make {n:,} unknowns; at most {UNKNOWNS:,} can be factored here")


def check_lean(inputs: Values) -> None:
    """Refuse a bristle that would land on its side."""
    lean = inputs.lean_deg
    if lean > LEAN_DEG * (1.0 + 1e-9):
        blame = next(name for name in ANGLES if getattr(inputs, name))
        refuse(
            blame,
            f"tilt and slope together lean the bristle by {lean:.3g} degrees against the surface's "
            f"normal; from {LEAN_DEG:g} on it lands on its side, which cannot touch here",
        )


def check_drop(inputs: DropValues) -> None:
    """Refuse a spring too soft for the bristle, steps too many or too long, too early an end."""
    _check_spring(inputs)
    fall_s, speed_m_s = free_fall(inputs.height_m, inputs.gravity_m_s2, inputs.alpha_1_s)
    strain = speed_m_s / inputs.bristle().material.bar_speed_m_s
    if strain > STRAIN:
        refuse(
            "youngs_Pa",
            f"{inputs.youngs_Pa:g} Pa is so soft that the impact, at {speed_m_s:.3g} m/s, would "
            f"strain the bristle by {strain:.2g}; small strains end at {STRAIN:g}",
        )
    _check_drag(inputs, speed_m_s)
    if not isinstance(inputs.until, Until) and inputs.until <= fall_s:
        refuse("until", f"ends at {inputs.until:g} s, but the bristle touches at {fall_s:.4g} s")
    if inputs.model is Model.ANALYTIC:
        return
    contact_s = inputs.contact_s()
    if inputs.its_s > LONGEST_STEP * contact_s:
        refuse(
            "its_s",
            f"{inputs.its_s:g} s steps over the whole impact, which lasts {contact_s:.2g} s",
        )
    if contact_s > STEPS * inputs.its_s:
        refuse(
            "its_s",
            f"{inputs.its_s:g} s makes about {contact_s / inputs.its_s:.2g} steps of "
            f"{contact_s:.2g} s; at most {STEPS:.0e} are taken",
        )


def _check_drag(inputs: DropValues, speed_m_s: float) -> None:
    """Refuse drag after which the spring could not throw a rigid bristle off against gravity."""
    if not inputs.alpha_1_s or math.isinf(inputs.kn_N_m):
        return
    quarter_s = quarter_period_s(inputs.bristle().mass_kg, inputs.kn_N_m)
    left_m_s = speed_m_s * math.exp(-inputs.alpha_1_s * quarter_s)
    if left_m_s * 0.5 * math.pi / quarter_s < REST * inputs.gravity_m_s2:
        refuse(
            "alpha_1_s",
            f"{inputs.alpha_1_s:g} 1/s is so strong a drag that the bristle, touching at "
            f"{speed_m_s:.2g} m/s, comes to rest on the surface",
        )


def _check_spring(inputs: DropValues) -> None:
    weight = inputs.bristle().mass_kg * inputs.gravity_m_s2
    depth = weight / inputs.kn_N_m + math.sqrt(2.0 * weight * inputs.height_m / inputs.kn_N_m)
    if depth > inputs.bristle().length_m:
        refuse(
            "kn_N_m",
            f"{inputs.kn_N_m:g} N/m is so soft that the bristle would sink {depth:.2g} m, "
            "more than its length",
        )


def input_warnings(inputs: DropValues) -> list[str]:
    """What a user should know before the run: value, limit, and what to change."""
    found = [*unit_warnings(inputs), *_damping_warnings(inputs)]
    if inputs.model is Model.ANALYTIC:
        return found
    return [*found, *_step_warnings(inputs), *_lean_warnings(inputs)]


def unit_warnings(inputs: BaseModel) -> list[str]:
    """Values far outside what bristles are, with the unit that was probably meant."""
    found = []
    for field, (low, high, units) in USUAL.items():
        value = getattr(inputs, field, None)
        if value is None or math.isinf(value) or low <= value <= high:
            continue
        unit, option = field.partition("_")[2].replace("_", "/"), OPTIONS[field]
        meant = (
            f"; if {value:g} {name} is meant, that is {option} {value * factor:g}"
            for name, factor in units.items()
            if low <= value * factor <= high
        )
        found.append(
            f"{option} {value:g} {unit} is far outside of what bristles are, {low:g} to {high:g} "
            f"{unit}{next(meant, '')}"
        )
    return found


def _damping_warnings(inputs: DropValues) -> list[str]:
    """Damping far beyond critical, or another material with that of the paper's steel bristle."""
    damping = inputs.bristle().axial_damping
    if damping > MOST_DAMPED:
        return [
            f"--beta {inputs.beta_s:g} s damps the first axial mode {damping:.3g} times "
            "critically: the bristle bounces as if it were rigid"
        ]
    same = math.isclose(inputs.youngs_Pa, paper.YOUNGS_PA, rel_tol=ALIKE) and math.isclose(
        inputs.density_kg_m3, paper.DENSITY_KG_M3, rel_tol=ALIKE
    )
    if same or inputs.beta_s != paper.BETA_S or inputs.model is Model.ANALYTIC:
        return []
    return [
        f"--youngs or --density is not the steel's, while --beta {inputs.beta_s:g} s is what the "
        "paper found on steel bristles; the rebound depends on it: give --material or --beta of "
        "this material, or run with --beta 0 to see how much it matters"
    ]


def _step_warnings(inputs: DropValues) -> list[str]:
    if math.isinf(inputs.kn_N_m):
        return []
    quarter_s = quarter_period_s(inputs.bristle().mass_kg, inputs.kn_N_m)
    if inputs.its_s <= quarter_s:
        return []
    return [
        f"--its {inputs.its_s:g} s is longer than the time to greatest penetration, "
        f"{quarter_s:.3g} s by Eq. 8: peak force and penetration are not resolved, and the "
        "rebound may be off; "
        f"take --its {round_down(0.1 * quarter_s):g} or less"
    ]


def _lean_warnings(inputs: DropValues) -> list[str]:
    found = []
    lean = inputs.lean_deg
    bent = inputs.resolved_deflection
    if bent is Deflection.FINITE:
        pass
    elif lean > LINEAR_LEAN_DEG * (1.0 + 1e-9):
        found.append(
            f"the bristle leans by {lean:.3g} degrees against the surface's normal; strain and "
            f"rotation are taken as small during contact, which is not checked above "
            f"{LINEAR_LEAN_DEG:g}: lean it less, or take the result as an estimate"
        )
    elif lean > SMALL_LEAN_DEG and bent is Deflection.SMALL:
        found.append(
            f"the bristle leans by {lean:.3g} degrees and is linear here, which leaves out how the "
            f"axial force bends it: above {SMALL_LEAN_DEG:g} degrees a tip that slides keeps too "
            "much speed, a tenth too much at 2 degrees; take --deflection second-order, or finite "
            "for the solid"
        )
    if inputs.tip is Tip.POINT and inputs.leaning and inputs.friction:
        found.append(
            f"--tip point with --friction {inputs.friction:g} and a lean: with a single point that "
            "sticks, the result does not converge as --elements and --its are refined; take --tip "
            "face"
        )
    return found


def check_result(inputs: DropValues, result: DropResult) -> None:
    """ComputationError where the energy budget of a conserving scheme says that it went astray."""
    closure = result.energy.closure_relative
    if _conserves(inputs) and closure > ASTRAY:
        raise ComputationError(
            f"the motion went astray: its energy budget is off by {closure:.2g} times the impact's "
            "energy; lean it less, or take --model solid"
        )


def result_warnings(inputs: DropValues, result: DropResult) -> list[str]:
    """What a user should know of the result."""
    found = _end_warnings(inputs, result)
    if _conserves(inputs):
        found += closure_warnings(inputs, [result.energy.closure_relative])
    error = result.reduction_error
    if error is not None and error > inputs.reduction_tolerance:
        found.append(
            f"the reduced model is off by about {error:.2g} of the impact speed, more than the "
            f"{inputs.reduction_tolerance:g} asked for, with all the vectors that it may take; "
            "raise --modes or take --model solid"
        )
    if inputs.leaning:
        found += [*_zone_warnings(inputs, result), *_patch_warnings(inputs, result)]
        found += _turning_warnings(inputs, result)
    return found


def _conserves(inputs: DropValues) -> bool:
    """Whether the budget should close: a rigid plane's multiplier does work of its own."""
    rigid = inputs.contact is Contact.AUGMENTED and math.isinf(inputs.kn_N_m)
    return inputs.scheme is Scheme.AVERAGE and not rigid


def closure_warnings(inputs: DropValues, closures: Sequence[float] | Array) -> list[str]:
    """Energy budgets, of one drop or many, that close worse than a conserving scheme's should."""
    leans = any(each.effect().leaning for each in inputs.effects)
    small = inputs.resolved_deflection is Deflection.SMALL and not leans
    allowed = CLOSURE if small else CLOSURE_BENT
    off = [closure for closure in closures if not closure <= allowed]
    if not off:
        return []
    which = "" if len(closures) == 1 else f"of {len(off)} of {len(closures)} drops "
    remedy = "shorten --its" if small else "take --model solid, or lean it less"
    return [
        f"the energy budget {which}closes to {max(off):.2g} of the impact's energy only, where "
        f"this scheme should keep {allowed:g}; {remedy}"
    ]


def _end_warnings(inputs: DropValues, result: DropResult) -> list[str]:
    """An end that leaves no rebound to be seen."""
    if isinstance(inputs.until, Until) or result.rebound_ratio is not None:
        return []
    where = "before the rebound is at its top"
    if math.isnan(result.contact_time_s):
        where = "within the first impact, whose time in contact is not known either"
    return [f"no rebound was seen: the drop ends at {inputs.until:g} s, {where}; raise --until"]


def narrow_zone(
    inputs: DropValues, depth_m: float, n_points: int | None = None
) -> tuple[float, float] | None:
    """Where fewer points touch than a pressure needs: the zone's width, and the points' distance.

    At the penetration ``depth_m`` an undeformed end face touches with all points that stand back
    less; they should be more than one row along both sides. None where they are.
    """
    section = inputs.end_section()
    xy, _ = section.contact_points(n_points or inputs.contact_points)
    normal, back = inputs.surface_normal, inputs.face_offsets_m(xy)
    gaps = xy @ normal[:2] + back * normal[2]
    gaps -= gaps.min()
    zone = gaps <= depth_m
    for axis in range(2):
        here = xy[zone, axis]
        if np.ptp(here) > 0.0:
            continue
        distance = np.abs(xy[:, axis] - here[0])
        spacing = float(distance[distance > 1e-6 * distance.max()].min())
        step = float(gaps[np.isclose(distance, spacing)].min())
        return spacing * depth_m / step, spacing
    return None


def _zone_warnings(inputs: DropValues, result: DropResult) -> list[str]:
    """A contact zone that falls between the contact points."""
    if inputs.tip is Tip.POINT or math.isinf(inputs.kn_N_m):
        return []
    depth = result.max_penetration_m
    found = narrow_zone(inputs, depth)
    if found is None:
        return []
    width, spacing = found
    more = range(inputs.contact_points + 1, MOST_CONTACT_POINTS + 1)
    enough = next((n for n in more if narrow_zone(inputs, depth, n) is None), None)
    remedy = "lean it less" if enough is None else f"take --contact-points {enough} or more"
    return [
        f"the surface is touched over about {1e6 * width:.3g} µm next to the edge, less than the "
        f"{1e6 * spacing:.3g} µm from there to the next of --contact-points "
        f"{inputs.contact_points}: force and penetration depend on their number; {remedy}"
    ]


def _patch_warnings(inputs: DropValues, result: DropResult) -> list[str]:
    """A contact patch that one cell covers."""
    section = inputs.bristle().section
    if not isinstance(section, Rectangle) or inputs.tip_shape != FLAT:
        return []
    if not inputs.model.meshed or inputs.cells is None or math.isinf(inputs.kn_N_m):
        return []
    found = []
    normal = inputs.surface_normal
    sides = (section.thickness_m, section.width_m)
    for axis, (side, toward) in enumerate(zip(sides, ("thin", "wide"), strict=True)):
        cell = side / inputs.cells[axis]
        rise = abs(normal[axis]) / normal[2]
        depth = result.max_penetration_m
        width = depth / rise if rise * side > depth else side
        if width < min(cell, side) * (1.0 - 1e-9):
            cells = list(inputs.cells)
            cells[axis] = math.ceil(side / width)
            found.append(
                f"toward the {toward} side the surface is touched over about {1e6 * width:.3g} µm, "
                f"less than the {1e6 * cell:.3g} µm of one cell: the force is right, since Kn sets "
                f"it, but stress near the contact is not resolved; for stress take --cells "
                f"{' '.join(map(str, cells))} or more"
            )
    return found


def _turning_warnings(inputs: DropValues, result: DropResult) -> list[str]:
    """A flight in which the bristle turns too fast, or too far, for what is computed of it."""
    found = []
    spin = math.hypot(*result.spin_after_rad_s)
    slowest = slowest_bending_1_s(inputs.bristle())
    if spin > SPIN * slowest:
        found.append(
            f"after the impact the bristle turns at {spin:.3g} rad/s, above {SPIN * slowest:.3g}, "
            f"{SPIN:g} of its slowest bending's {slowest:.3g} rad/s: the flight leaves out how "
            "turning changes the ringing, so later touches and the tip's height are rough; use "
            "the numbers of the centre of mass, or lower --height"
        )
    airborne_s = 2.0 * result.cm_velocity_after_m_s / inputs.gravity_m_s2
    tumbled = math.degrees(math.hypot(*result.spin_after_rad_s[:2]) * airborne_s)
    lean = inputs.lean_deg
    if result.rebound_ratio is not None and lean + tumbled > FALLEN_DEG:
        found.append(
            f"after the impact the bristle turns by about {tumbled:.3g} degrees before it comes "
            f"down; with its lean of {lean:.3g} that may exceed {FALLEN_DEG:g}: its side or upper "
            "end, which cannot touch here, would then land first; use the velocities after the "
            "impact, or lower --height"
        )
    return found


def slowest_bending_1_s(bristle: Bristle) -> float:
    """Lowest elastic angular frequency of a thin free bar (Euler and Bernoulli)."""
    section, material = bristle.section, bristle.material
    second_moment = min(section.second_moment_x_m4, section.second_moment_y_m4)
    gyration = math.sqrt(second_moment / section.area_m2)
    return (FREE_BENDING / bristle.length_m) ** 2 * material.bar_speed_m_s * gyration


def round_down(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``value``."""
    decade = 10.0 ** math.floor(math.log10(value) + 1e-9)
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= value * (1 + 1e-9))
