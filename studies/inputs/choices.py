"""Choices of a user: models, schemes, ends of a run."""

from __future__ import annotations

from enum import StrEnum


class Model(StrEnum):
    """The bodies that a drop can be computed with."""

    ANALYTIC = "analytic"
    BEAM = "beam"
    REDUCED = "reduced"
    SOLID = "solid"

    @property
    def meshed(self) -> bool:
        """Whether it needs a mesh of hexahedra."""
        return self in (Model.REDUCED, Model.SOLID)


class Contact(StrEnum):
    """How the contact law is enforced; the values are those of solver.contact.enforcement."""

    PENALTY = "penalty"
    AUGMENTED = "augmented"
    NITSCHE = "nitsche"


class Scheme(StrEnum):
    """The time schemes of solver.time.scheme."""

    AVERAGE = "average"
    NEWMARK = "newmark"
    GENERALISED = "generalised"


class Tip(StrEnum):
    """What meets the surface: the end section point by point, or one node on the axis."""

    FACE = "face"
    POINT = "point"


class Deflection(StrEnum):
    """How far bending and turning go into a leaning body's equations: see solver.bodies.axis and
    solver.forms."""

    SMALL = "small"
    SECOND_ORDER = "second-order"
    FINITE = "finite"


class Solver(StrEnum):
    """What solves a solid's equations; the values are those of solver.bodies.linear."""

    AUTO = "auto"
    DIRECT = "direct"
    ITERATIVE = "iterative"


class Layout(StrEnum):
    """How bristles stand in a brush: see studies.brush.layout."""

    SINGLE = "single"
    ROW = "row"
    RING = "ring"
    CUP = "cup"


class Motion(StrEnum):
    """How a brush's hub moves: see studies.brush.motion."""

    PRESS = "press"
    SLIDE = "slide"
    ROTATE = "rotate"
    FILE = "file"


class Until(StrEnum):
    """Where a drop ends, other than at a given time."""

    IMPACT = "impact"
    REBOUND = "rebound"


class Noise(StrEnum):
    """How errors of measurement are distributed, at the declared standard deviation.

    Heavy-tailed ones follow Student's distribution of three degrees of freedom. Of outliers, one
    in twenty is five times as large. Autocorrelated errors of neighbouring drops correlate by a
    half.
    """

    GAUSSIAN = "gaussian"
    HEAVY = "heavy-tailed"
    OUTLIERS = "outliers"
    CORRELATED = "autocorrelated"


class Strange(StrEnum):
    """Effects that no list has: of them the loop can only say that something is missing."""

    SHIFT = "session-shift"
    RIPPLE = "height-ripple"
    ALTERNATION = "alternation"


class Body(StrEnum):
    """What falls in a film."""

    BRISTLE = "bristle"
    BALL = "ball"


class Down(StrEnum):
    """Which way things fall in a picture; ``auto`` tries each, ``down`` first."""

    AUTO = "auto"
    DOWN = "down"
    LEFT = "left"
    RIGHT = "right"
    UP = "up"
