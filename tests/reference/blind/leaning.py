"""Impact and flight of a bristle that leans or lands on a slope, to second order in its slope.

Displacements along the axis and across it are series of free modes, in a frame that falls upright
with the bristle's axis as it was at first touch. Where the bar bends, its tip is drawn towards the
centre of mass by ½ ∫ (1 - x/L) w'² dx; the same integral gives the moment of the axial force about
the bent axis, so that energy is kept. The end face meets the surface at a grid of points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .body import Array, Body, bending, free_steps
from .face import COARSE_S, march
from .upright import GRAVITY_M_S2

FINE_S = 1.5e-7
FLIGHT_STEPS = 100
# Across each side of the face; the outermost is half a percent from the edge, which lets go last.
FACE_POINTS = 16


@dataclass(frozen=True)
class Lean:
    """How a bristle meets the surface: its own lean towards the thin side, the surface's slopes
    towards the thin and the wide side, all in degrees, and the coefficient of friction."""

    tilt_deg: float = 0.0
    slope_deg: float = 0.0
    slope_wide_deg: float = 0.0
    friction: float = 0.0


@dataclass(frozen=True)
class Landed:
    """The greatest height of the lower tip after an impact, the centre of mass' speed upwards at
    the last release, the time from first touch until then, the greatest force, and the energy of
    all modes with that of the height."""

    top_m: float
    speed_m_s: float
    contact_time_s: float
    peak_force_N: float
    energy_J: float


def land(
    body: Body,
    kn_N_m: float,
    lean: Lean,
    speed_m_s: float,
    gravity_m_s2: float = GRAVITY_M_S2,
    dt_s: float = FINE_S,
) -> Landed:
    """Let a bristle of rectangular section come down with ``speed_m_s``."""
    return _Impact(body, kn_N_m, lean, gravity_m_s2, dt_s).run(speed_m_s)


def _omega(body: Body) -> Array:
    """Axial modes, the two motions across, then the modes of either plane."""
    planes = [bending(body, depth).omega for depth in (body.thickness_m, body.width_m)]
    return np.concatenate([body.axial_omega(), np.zeros(2), *planes])


@lru_cache(maxsize=16)
def _drifts(body: Body, dt: float) -> tuple[Array, Array]:
    """Free steps of all modes over ``dt`` and over a long step."""
    omega = _omega(body)
    fine, coarse = (free_steps(omega, body.damping(omega), h) for h in (dt, COARSE_S))
    return fine, coarse


class _Impact:
    """One impact: the modes' motion in turn marched in contact and followed in flight."""

    def __init__(self, body: Body, kn_N_m: float, lean: Lean, gravity: float, dt: float) -> None:
        thin, wide = bending(body, body.thickness_m), bending(body, body.width_m)
        self.body, self.gravity = body, gravity
        self.omega = _omega(body)
        self.damping = body.damping(self.omega)
        na, nb = len(body.axial_omega()), len(thin.omega)
        self.sizes = np.array([na, nb])
        self.tip = np.concatenate(
            [body.axial_tip(), np.full(2, body.mass_kg**-0.5), thin.tip, wide.tip]
        )
        self.slope = np.concatenate([np.zeros(na + 2), thin.slope, wide.slope])
        self.shortens = np.stack([thin.shortens, wide.shortens])
        self.fine, self.coarse = _drifts(body, dt)
        self.dt = dt
        t, a, b = np.deg2rad([lean.tilt_deg, lean.slope_deg, lean.slope_wide_deg])
        normal = np.array([1.0, math.tan(t + a), math.tan(b)])
        self.normal = normal / np.linalg.norm(normal)
        self.up = np.array([math.cos(t), math.sin(t), 0.0])
        self.points = _points(body, lean)
        self.delay = body.beta_s if body.beta_s > 2e-7 else 0.0
        left_out = body.left_out_m_N()
        self.soft = left_out if self.delay else 0.0
        self.kn = kn_N_m if self.delay else 1.0 / (1.0 / kn_N_m + left_out)
        mindlin = 2.0 * (1.0 - body.poisson) / (2.0 - body.poisson)
        self.numbers = np.array(
            [self.kn, mindlin * kn_N_m, lean.friction, self.soft, self.delay, gravity]
        )

    def run(self, speed: float) -> Landed:
        na = self.sizes[0]
        q, v = np.zeros_like(self.omega), np.zeros_like(self.omega)
        unit = self.body.mass_kg**-0.5
        rigid = [0, na, na + 1]
        v[rigid] = -speed * self.up / unit
        memory = np.zeros((len(self.points), 2))
        offset = self.points[:, 0] * self.normal[1] + self.points[:, 1] * self.normal[2]
        lowest, time, last, peak = float(offset.min()), 0.0, 0.0, 0.0
        for _ in range(60):
            ended, let_go, most = march(
                q, v, self.fine, self.coarse, self.tip, self.slope, self.shortens, self.sizes,
                self.points, self.normal, self.up, lowest, memory, self.numbers, self.dt,
            )  # fmt: skip
            # let go within the step after the last one in contact
            last = time + let_go + 0.5 * self.dt if let_go > 0.0 else last
            time, peak = time + ended, max(peak, most)
            fast = float(v[rigid] @ self.up) * unit
            if fast <= 0.0:
                break
            again, top = self._fly(q, v, fast, lowest)
            if again is None:
                fast += self.gravity * (time - last)
                return Landed(max(0.0, top), fast, last, peak, self._energy(q, v))
            q, v = self._at(q, v, np.array([again]))
            q, v, time = q[:, 0].copy(), v[:, 0].copy(), time + again
        return Landed(max(0.0, self._height(q)), fast, last, peak, self._energy(q, v))

    def _energy(self, q: Array, v: Array) -> float:
        na = self.sizes[0]
        raised = q[[0, na, na + 1]] @ self.up * self.body.mass_kg**0.5
        return float(0.5 * np.sum(v**2 + (self.omega * q) ** 2) + self.gravity * raised)

    def _fly(self, q: Array, v: Array, fast: float, lowest: float) -> tuple[float | None, float]:
        """When the face touches again before the centre of mass turns to fall, None where it does
        not; and the greatest height of the tip before the face touches after that."""
        times = np.linspace(0.0, 2.2 * fast / self.gravity, FLIGHT_STEPS)
        moved, slopes = self._tip(self._at(q, v, times)[0])
        tilted = self.normal[1:, None] - slopes * self.normal[0]
        gaps = self.normal @ moved - lowest + (self.points[:, :2] @ tilted).min(axis=0)
        down = np.flatnonzero((gaps < 0.0) & (times > 0.0))
        first = int(down[0]) if len(down) else len(times)
        if first < len(times) and times[first] < fast / self.gravity:
            return float(times[first - 1]), 0.0
        return None, float((self.up @ moved)[:first].max())

    def _at(self, q: Array, v: Array, times: Array) -> tuple[Array, Array]:
        """Displacements and velocities (modes, times) in free flight."""
        w2, half = (self.omega**2)[:, None], 0.5 * self.damping[:, None]
        root = np.sqrt((w2 - half**2).astype(complex))
        root = np.where(np.abs(root) < 1e-9, 1e-9, root)
        t = times[None]
        p, r = q[:, None].astype(complex), v[:, None].astype(complex)
        plus, minus = np.exp((-half + 1j * root) * t), np.exp((-half - 1j * root) * t)
        cosine, sine = 0.5 * (plus + minus), (plus - minus) / (2j * root)
        moved = p * (cosine + half * sine) + r * sine
        fast = r * (cosine - half * sine) - w2 * p * sine
        x, u = moved.real, fast.real
        na = self.sizes[0]
        for row, along in zip((0, na, na + 1), self.up, strict=True):
            fall = self.gravity * along * self.body.mass_kg**0.5
            x[row] = q[row] + v[row] * times - 0.5 * fall * times**2
            u[row] = v[row] - fall * times
        return x, u

    def _tip(self, q: Array) -> tuple[Array, Array]:
        """Displacements (3, times) of the face's centre and its slopes (2, times) for modes (n,
        times), turns taken exactly."""
        na, nb = self.sizes
        moved, slopes = np.zeros((3, q.shape[1])), np.zeros((2, q.shape[1]))
        moved[0] = self.tip[:na] @ q[:na]
        half = 0.5 * self.body.length_m
        for k in range(2):
            first = na + 2 + k * nb
            mine = q[first : first + nb]
            moved[1 + k] = q[na + k] * self.tip[na + k] + self.tip[first : first + nb] @ mine
            slopes[k] = self.slope[first : first + nb] @ mine
            turn = mine[0] * self.slope[first]
            moved[0] += 0.5 * np.sum(mine * (self.shortens[k] @ mine), axis=0)
            moved[0] += half * (1.0 - np.cos(turn) - 0.5 * turn**2)
            moved[1 + k] += half * (turn - np.sin(turn))
        return moved, slopes

    def _height(self, q: Array) -> float:
        return float(self.up @ self._tip(q[:, None])[0][:, 0])


def _points(body: Body, lean: Lean) -> Array:
    """Points of the end face (n, 3): place across and share of Kn; across the thickness alone
    where it leans that way alone."""
    line, weights = np.polynomial.legendre.leggauss(FACE_POINTS)
    line, weights = 0.5 * line, 0.5 * weights
    if not lean.slope_wide_deg:
        return np.column_stack([line * body.thickness_m, np.zeros(FACE_POINTS), weights])
    one, two = np.meshgrid(line * body.thickness_m, line * body.width_m, indexing="ij")
    return np.column_stack([one.ravel(), two.ravel(), np.outer(weights, weights).ravel()])
