"""Inputs of `bristle brush` beyond those of a bristle: layout, motion of the hub, surface."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator

from ...solver import paper
from .choices import Layout
from .fields import (
    CONTACT,
    LONGEST_S,
    MESH,
    OUTPUT,
    TIME,
    BodyFields,
    Kn,
    MaterialFields,
    Ratio,
    Truth,
    above_zero,
    between,
    kt_ratio_option,
    whole,
)
from .flags import Fields, flags_of, option
from .named import MotionInput, read_motion
from .study_fields import SEEDS, SURFACE, ReliefFields

BRUSH, HUB = "Brush", "Hub"
MOST_BRISTLES = 20_000
# Rows of a table over time where nothing else is asked for.
ROWS_OVER_TIME = 200
SHORTEST_EVERY_S = 1e-7


class LayoutFields(Fields, group=BRUSH):
    """How bristles are clamped in the hub."""

    layout: Layout = option(
        Layout.SINGLE,
        "single: one bristle in the hub's middle. row: across the direction of motion. ring: "
        "around the hub's axis. cup: tufts on rings around it, as in a gutter brush.",
    )
    count: Annotated[int, whole(1, MOST_BRISTLES)] = option(
        1, "Number of bristles in the whole brush.", "N"
    )
    rows: Annotated[int, whole(1, 1000)] = option(
        1, "Number of rows one behind the other, or of rings one inside the other.", "N"
    )
    tufts: Annotated[int, whole(1, 1000)] = option(
        12, "Number of tufts on each ring of a cup.", "N"
    )
    radius_m: Annotated[float, above_zero(10.0)] = option(0.1, "Radius of the outermost ring.")
    spacing_m: Annotated[float, above_zero(1.0)] = option(
        4e-3, "Distance of neighbouring bristles, and of neighbouring rows or rings."
    )
    mount_angle_deg: Annotated[float, between(-80.0, 80.0)] = option(
        20.0,
        "How far the clamp leans from the surface's normal in the direction of motion: the tip "
        "trails where it is positive. That direction is x, or the circumference where the hub "
        "rotates.",
    )
    flare_deg: Annotated[float, between(-80.0, 80.0)] = option(
        0.0, "How far bristles of a ring or a cup spread outward from the hub's axis."
    )
    twist_deg: Annotated[float, between(-360.0, 360.0)] = option(
        0.0,
        "Turn of each bristle about its axis. Without it the thin side faces the direction of "
        "motion.",
    )
    angle_std_deg: Annotated[float, between(0.0, 15.0)] = option(
        0.0, "Standard deviation of each clamp's lean, both along and across the motion."
    )
    length_std_m: Annotated[float, between(0.0, 0.1)] = option(
        0.0, "Standard deviation of the bristles' lengths."
    )
    seed: Annotated[int, whole(0, SEEDS)] = option(0, "Seed of the leans and lengths.", "N")


class HubFields(Fields, group=HUB):
    """How the hub moves, and for how long."""

    motion: Annotated[MotionInput, BeforeValidator(read_motion)] = option(
        "slide:speed=1",
        "press: down alone. slide:speed=M/S: along x. rotate:rpm=RPM: about the vertical. "
        "file:FILE.csv: a path of the hub with the columns t_s, x_m, y_m, z_m, rx_rad, ry_rad, "
        "rz_rad (rotation vector); the surface is z = 0.",
        "MOTION",
        kind=str,
    )
    penetration_m: Annotated[float, between(0.0, 10.0)] | None = option(
        None,
        "How far the hub comes down below the height where the first bristle touches.",
        shown="0.02; not for a path from a file",
    )
    start_s: Annotated[float, between(1e-4, LONGEST_S)] = option(
        0.1,
        "Time in which the hub comes down and reaches its speed, from rest. Means begin after it.",
    )
    until_s: Annotated[float, between(1e-6, LONGEST_S)] | None = option(
        None, "Time at which to stop.", shown="1; a file's end", group=TIME
    )
    every_s: Annotated[float, between(SHORTEST_EVERY_S, LONGEST_S)] | None = option(
        None,
        "Time between rows of hub.csv and tips.csv, and between frames for ParaView.",
        shown="a 200th of the whole",
        group=TIME,
    )
    gravity_m_s2: Annotated[float, between(0.0, 1e4)] = option(paper.GRAVITY_M_S2, "Gravity.")


class SurfaceFields(ReliefFields, group=CONTACT):
    """What bristles meet, and where they yield."""

    rms_height_m: Annotated[float, between(0.0, 0.1)] | None = option(
        None,
        "Root mean square height of a rough surface. Its aggregates differ in stiffness, and "
        "--kn is their mean.",
        shown="a level plane of one material",
        group=SURFACE,
    )
    kn_N_m: Kn = option(
        paper.KN_CHOSEN_N_M,
        "Normal contact stiffness of an end section, and of two bristles that cross. 'inf' is a "
        "nearly rigid contact.",
    )
    friction: Annotated[float, between(0.0, 100.0)] = option(
        paper.FRICTION, "Coulomb's coefficient of a tip that slides.", "MU"
    )
    friction_static: Annotated[float, between(0.0, 100.0)] | None = option(
        None, "Coulomb's coefficient of a tip that sticks.", "MU", "that of --friction"
    )
    stribeck_speed_m_s: Annotated[float, above_zero(100.0)] = option(
        0.01, "Speed over which friction falls from the static to the sliding coefficient."
    )
    kt_ratio: Ratio | None = kt_ratio_option("")
    touch_each_other: Truth = option(
        True,
        "Contact of bristles with each other. Without it they pass through each other.",
        name="bristle-contact",
    )
    friction_between: Annotated[float, between(0.0, 100.0)] | None = option(
        None,
        "Coulomb's coefficient of one bristle on another, at any speed.",
        "MU",
        "that of --friction",
    )
    yield_strength_Pa: Annotated[float, between(1e3, 1e12)] | None = option(
        None,
        "Yield strength, beyond which a warning says that bristles stay bent.",
        shown="that of --material",
    )


class BrushFields(SurfaceFields, HubFields, LayoutFields):
    """What a brush has beside its bristles."""

    elements: Annotated[int, whole(2, 1000)] = option(
        20, "Elements along each bristle.", "N", group=MESH
    )
    tolerance: Annotated[float, between(1e-9, 1e-2)] = option(
        1e-6,
        "Greatest error of a time step, divided by the length of the shortest bristle. Steps are "
        "as long as it allows.",
        "RATIO",
        group=TIME,
    )
    write_fields: Truth = option(
        True,
        "Series of the bristles for ParaView. It is written unless --no-fields.",
        name="fields",
        group=OUTPUT,
    )


BRUSH_OWN_FLAGS = flags_of(LayoutFields, HubFields, SurfaceFields, BrushFields)
BRUSH_FLAGS = (*BRUSH_OWN_FLAGS, *flags_of(BodyFields, MaterialFields))
