"""Contact laws and Coulomb friction: force from penetration and slip, with potentials.

The classes hold parameters and work on NumPy arrays; the compiled laws are in contact.normal.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar, cast

import numpy as np

from .. import paper
from ..arrays import Array
from .normal import ADHESIVE, HUNT_CROSSLEY, LINEAR, PLASTIC, STIFFENING, TABULATED, elastic_at
from .points import Kind

Each = Array | float
"""A number for each point, or one for all."""

# Penetration of the paper's drops, at which a stiffening law has the secant stiffness Kn.
REFERENCE_M = 2e-5
# Cells of the compiled table of a tabulated law.
CELLS = 256


class ContactLaw:
    """Base of contact laws: normal force over penetration, with damping.

    A law is a dataclass. Its fields are its parameters, ``kn_N_m`` first, and its `Kind` computes
    with them (docs/effects.md shows how to write one). ``force`` is per unit of area share: the
    total force if the whole face were like this point. ``approach`` (m) is the penetration that the
    point would have without the compliance ``compliance_m_N``: penetration =
    approach - compliance × force. So one law serves penalty (no compliance), Nitsche (its
    stabilisation) and the augmented Lagrangian (1/r). ``scale`` (n,) is each point's stiffness over
    the law's. ``memory`` (n,) is the internal variable of a law that has one, zero before the first
    touch.
    """

    # The law's reference stiffness in N/m; infinite on a rigid plane.
    kn_N_m: float
    kind: ClassVar[Kind]
    # Whether it needs the conserving scheme and no compliance in series.
    conserving_only: ClassVar[bool] = True

    @property
    def parameters(self) -> Array:
        """The numbers that its `Kind` reads: Kn first."""
        return np.array([getattr(self, each.name) for each in fields(cast(Any, self))], dtype=float)

    @property
    def damping(self) -> float:
        """Factor of the speed of penetration: in N s/m for a dashpot, in s/m for Hunt and
        Crossley's law. Contact with damping never pulls."""
        return 0.0

    @property
    def pulls(self) -> bool:
        """Whether its force can be tensile, and so end with a jump."""
        return self.kind.pulls

    def _at_points(
        self, which: int, approach: Array, compliance_m_N: float, scale: Each, memory: Each
    ) -> Array:
        every = np.broadcast_arrays(approach, scale, memory)
        d, s, m = (np.array(each, dtype=float).ravel() for each in every)
        found = elastic_at(self.kind, self.parameters, s, d, compliance_m_N, m)
        return np.asarray(found[which].reshape(every[0].shape))

    def force(
        self, approach: Array, compliance_m_N: float, scale: Each = 1.0, memory: Each = 0.0
    ) -> Array:
        """Force (n,) in N, without damping."""
        return self._at_points(0, approach, compliance_m_N, scale, memory)

    def tangent(
        self, approach: Array, compliance_m_N: float, scale: Each = 1.0, memory: Each = 0.0
    ) -> Array:
        """d force / d approach (n,) in N/m."""
        return self._at_points(1, approach, compliance_m_N, scale, memory)

    def potential(
        self, approach: Array, compliance_m_N: float, scale: Each = 1.0, memory: Each = 0.0
    ) -> Array:
        """Stored energy (n,) in J: the antiderivative of ``force`` in ``approach``, zero out of
        contact. Beyond yield or pull-off it still includes what was dissipated there, until
        ``memory`` records it."""
        return self._at_points(2, approach, compliance_m_N, scale, memory)


def _check(what: str, value: float, least: float = 0.0, *, included: bool = False) -> None:
    above = value >= least if included else value > least
    if not (above and math.isfinite(value)):
        words = f"{least:g} or more" if included else f"more than {least:g}"
        raise ValueError(f"{what} must be finite and {words}, not {value}")


@dataclass(frozen=True)
class Linear(ContactLaw):
    """Force = Kn × penetration (Eq. 3 of the paper); Kn = ∞ is Signorini's rigid contact."""

    kn_N_m: float

    kind: ClassVar[Kind] = LINEAR
    conserving_only: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not np.all(np.asarray(self.kn_N_m) > 0.0):
            raise ValueError(f"Kn must be positive, not {self.kn_N_m}")


@dataclass(frozen=True)
class Damped(Linear):
    """A spring Kn with a dashpot in parallel (Kelvin and Voigt): energy loss in the contact."""

    c_N_s_m: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _check("contact damping", self.c_N_s_m, included=True)

    @property
    def damping(self) -> float:
        return self.c_N_s_m


@dataclass(frozen=True)
class Stiffening(ContactLaw):
    """Force = Kn δref (δ/δref)^p: grows faster than the penetration δ, without loss.

    p = 1 is `Linear`, 3/2 Hertz's sphere (J. reine angew. Math. 92, 1882). Asperities touched one
    after another reach about 3. Kn is the secant stiffness at the penetration ``reference_m``.
    """

    kn_N_m: float
    exponent: float = 1.5
    reference_m: float = REFERENCE_M

    kind: ClassVar[Kind] = STIFFENING
    conserving_only: ClassVar[bool] = False

    def __post_init__(self) -> None:
        _check("Kn of a stiffening contact", self.kn_N_m)
        _check("the reference penetration", self.reference_m)
        if not 1.0 <= self.exponent <= 3.0:
            raise ValueError(f"the contact's exponent must be 1 to 3, not {self.exponent}")


@dataclass(frozen=True)
class Tabulated(ContactLaw):
    """Force = Kn × a table over penetration, without loss: measured by indentation, or computed
    from a function (`Tabulated.of`).

    ``penetration_m`` and ``force_over_kn_m`` (n,), tuples or arrays, start at zero and increase.
    Monotone cubics interpolate the points (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 1980); the
    last continues as a straight line. Compiled code uses ``CELLS`` equal cells, which smooths
    points that lie closer.
    """

    kn_N_m: float
    penetration_m: tuple[float, ...]
    force_over_kn_m: tuple[float, ...]

    kind: ClassVar[Kind] = TABULATED

    def __post_init__(self) -> None:
        _check("Kn of a tabulated contact", self.kn_N_m)
        for what, name in (("penetrations", "penetration_m"), ("forces", "force_over_kn_m")):
            # laws are compared by value, which arrays do not support
            row = tuple(map(float, getattr(self, name)))
            object.__setattr__(self, name, row)
            steps = np.diff(row)
            if not (len(steps) and row[0] == 0.0 and np.all(steps > 0.0) and row[-1] < math.inf):
                raise ValueError(f"{what} of a tabulated contact must begin with zero and increase")
        if len(self.penetration_m) != len(self.force_over_kn_m):
            raise ValueError("a tabulated contact needs as many forces as penetrations")

    @classmethod
    def of(
        cls, kn_N_m: float, force_over_kn: Callable[[Array], Array], reach_m: float
    ) -> Tabulated:
        """The law whose force over Kn (n,) in m is a function of penetrations (n,) in m up to
        ``reach_m``."""
        depth = np.linspace(0.0, reach_m, CELLS + 1)
        return cls(kn_N_m, tuple(depth), tuple(force_over_kn(depth)))

    @cached_property
    def _table(self) -> Array:
        from scipy.interpolate import PchipInterpolator

        nodes = np.linspace(0.0, self.penetration_m[-1], CELLS + 1)
        force = PchipInterpolator(self.penetration_m, self.force_over_kn_m)(nodes)
        through = PchipInterpolator(nodes, force)
        columns = np.stack([force, through(nodes, 1), through.antiderivative()(nodes)], axis=1)
        return np.concatenate([nodes[1:2], columns.ravel()])

    @property
    def parameters(self) -> Array:
        return np.concatenate([[self.kn_N_m], self._table])


@dataclass(frozen=True)
class HuntCrossley(ContactLaw):
    """Force = Kn δ (1 + λ dδ/dt), never tensile: loss that grows with the penetration δ.

    Hunt and Crossley, J. Appl. Mech. 42 (1975), with exponent one. Unlike a dashpot's, its force
    starts and ends at zero. For small λ a mass that arrives at speed v leaves at v (1 - ⅔ λ v).
    """

    kn_N_m: float
    damping_s_m: float

    kind: ClassVar[Kind] = HUNT_CROSSLEY

    def __post_init__(self) -> None:
        _check("Kn of a damped contact", self.kn_N_m)
        _check("Hunt and Crossley's damping", self.damping_s_m, included=True)

    @property
    def damping(self) -> float:
        return self.damping_s_m


@dataclass(frozen=True)
class Plastic(ContactLaw):
    """Elastic-plastic normal contact: perfectly plastic (Johnson, Contact Mechanics, 1985, Ch. 6),
    or with ``hardening``.

    The force grows with Kn up to ``yield_N``, then with ``hardening`` times Kn, which leaves a
    permanent indentation. Unloading and reloading have ``unloading`` times Kn (O. R. Walton and R.
    L. Braun, J. Rheol. 30 (1986) 949, beyond yield). ``yield_N`` is the force at which the whole
    face yields; every point yields at the same traction, whatever its stiffness. The indentation
    lasts through one impact: micro-touches some 100 µs apart share it. The next impact meets a
    fresh place, since a bristle that bounced does not land on the same microns.
    """

    kn_N_m: float
    yield_N: float
    hardening: float = 0.0
    unloading: float = 1.0

    kind: ClassVar[Kind] = PLASTIC

    def __post_init__(self) -> None:
        _check("Kn of a plastic contact", self.kn_N_m)
        _check("the yield force", self.yield_N)
        _check("unloading over Kn", self.unloading, 1.0, included=True)
        if not 0.0 <= self.hardening < 1.0:
            raise ValueError(f"hardening over Kn must be 0 to below 1, not {self.hardening}")


@dataclass(frozen=True)
class Adhesive(ContactLaw):
    """A spring Kn that, once touched, also pulls with up to ``pull_off_N``, then lets go.

    The pull-off force is that of Johnson, Kendall and Roberts (Proc. R. Soc. A 324, 1971) in its
    simplest form: touching costs nothing, letting go takes the spring's energy F²/(2 Kn).
    ``pull_off_N`` is the force at which the whole face lets go; every point does so at the same
    traction, whatever its stiffness. A touch ends when no point is held.
    """

    kn_N_m: float
    pull_off_N: float

    kind: ClassVar[Kind] = ADHESIVE

    def __post_init__(self) -> None:
        _check("Kn of an adhesive contact", self.kn_N_m)
        _check("the pull-off force", self.pull_off_N, included=True)


def check_compiled(law: ContactLaw) -> None:
    """TypeError if a law overrides the force of its kind, which compiled code would ignore."""
    for name in ("force", "tangent", "potential"):
        if getattr(type(law), name) is not getattr(ContactLaw, name):
            raise TypeError(f"{type(law).__name__}.{name} is ignored: a law's `kind` has its force")


def mindlin_ratio(poisson: float) -> float:
    """Tangential over normal stiffness of an elastic contact that sticks: 2(1-ν)/(2-ν).

    Mindlin, J. Appl. Mech. 16 (1949); the same for every nearly round contour.
    """
    return 2.0 * (1.0 - poisson) / (2.0 - poisson)


@dataclass(frozen=True)
class Coulomb:
    """Coulomb friction behind an elastic tangential spring: sticking without creep.

    Friction is at most ``mu`` times the normal force. The spring's stiffness is ``kt_over_kn``
    times Kn, by default Mindlin's ratio for the paper's steel; it is rigid on a rigid plane.
    """

    mu: float = 0.0
    kt_over_kn: float = mindlin_ratio(paper.POISSON)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.mu) and self.mu >= 0.0):
            raise ValueError(f"the coefficient of friction must be zero or more, not {self.mu}")
        if not self.kt_over_kn > 0.0:
            raise ValueError(f"Kt / Kn must be positive, not {self.kt_over_kn}")
