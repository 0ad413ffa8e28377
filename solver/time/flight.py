"""Free flight under gravity, exactly: every mode in closed form, the next touch as a root."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from ..bodies.base import Array
from ..bodies.modal import ModalBody

Complex = NDArray[np.complex128]
SAMPLES_PER_PERIOD = 16
CHUNK = 2048
# Far below the rounding of a height of millimetres.
NEGLIGIBLE_M = 1e-19


@dataclass(frozen=True)
class Rows:
    """What is watched in flight: ``of_u`` (m, n) of the displacement, ``of_v`` of the velocity."""

    of_u: Array
    of_v: Array | None = None

    def along(self, power: Complex) -> Complex | Array:
        """Rows (m, n) for modes that go as exp(``power`` t)."""
        return self.of_u if self.of_v is None else self.of_u + power * self.of_v


class Flight:
    """Motion of a modal body from a state (u, v) at ``t0_s`` with nothing but gravity acting.

    Each elastic mode is the sum of two complex exponentials (ω² and c = α + β ω² give under- and
    overdamped modes alike); a rigid motion falls, damped by α. Times are absolute, in s.
    """

    def __init__(
        self, body: ModalBody, t0_s: float, u: Array, v: Array, gravity_m_s2: float
    ) -> None:
        self.body, self.t0_s = body, t0_s
        self._u0, self._v0 = u, v
        rigid = body.omega2 == 0.0
        self._rigid = rigid
        self._pull = -gravity_m_s2 * body.lift
        damping = body.alpha_1_s + body.beta_s * body.omega2
        root = np.sqrt((damping**2 - 4.0 * body.omega2).astype(complex))
        # critically damped modes have no second exponential; split roots err by the split squared
        root = np.where(~rigid & (np.abs(root) < 1e-6 * damping), 1e-6 * damping + 0j, root)
        # the smaller root from the product of both, free of cancellation
        self._fast = -0.5 * (damping + root)
        self._slow = np.divide(
            body.omega2, self._fast, out=np.zeros_like(self._fast), where=self._fast != 0.0
        )
        gap = np.where(rigid, 1.0, self._fast - self._slow)
        self._fast_part = np.where(rigid, 0.0, (v - self._slow * u) / gap)
        self._slow_part = np.where(rigid, 0.0, u - self._fast_part)
        self._forced = np.divide(self._pull, body.omega2, out=np.zeros_like(u), where=~rigid)
        # gravity pulls at no elastic mode of a free body; of a held one it shifts the rest state
        self._slow_part = self._slow_part - np.where(rigid, 0.0, self._static_slow(gap))
        self._fast_part = self._fast_part - np.where(rigid, 0.0, self._static_fast(gap))

    def _static_fast(self, gap: Complex) -> Complex:
        return -self._slow * self._forced / gap

    def _static_slow(self, gap: Complex) -> Complex:
        return self._forced - self._static_fast(gap)

    def state(self, t_s: float) -> tuple[Array, Array]:
        """Displacement and velocity (n,) each at ``t_s``."""
        t = t_s - self.t0_s
        fast, slow = np.exp(self._fast * t), np.exp(self._slow * t)
        u = (self._fast_part * fast + self._slow_part * slow).real + self._forced
        v = (self._fast * self._fast_part * fast + self._slow * self._slow_part * slow).real
        r = self._rigid
        (u[r],), (v[r],) = self._fall(np.array([t]), r)
        return u, v

    def centre_velocity(self, t_s: float) -> float:
        """Upward velocity of the centre of mass at ``t_s``, which may lie before the start."""
        velocity = self._fall(np.array([t_s - self.t0_s]), self._rigid)[1][0]
        return float(self.body.lift[self._rigid] @ velocity) / self.body.mass_kg

    def _fall(self, t: Array, which: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Rigid displacements and velocities (times, motions) at times ``t`` after the start."""
        alpha = self.body.alpha_1_s
        u0, v0, pull = self._u0[which], self._v0[which], self._pull[which]
        t = t[:, None]
        if alpha == 0.0:
            return u0 + t * (v0 + 0.5 * t * pull), v0 + t * pull
        decayed = -np.expm1(-alpha * t) / alpha
        return (
            u0 + v0 * decayed + pull * (t - decayed) / alpha,
            v0 * np.exp(-alpha * t) + pull * decayed,
        )

    def observe(self, rows: Rows, t_s: Array) -> Array:
        """``rows`` at increasing times ``t_s`` (k,): (k, m)."""
        t = np.asarray(t_s) - self.t0_s
        height, speed = self._fall(t, self._rigid)
        out = height @ rows.of_u[:, self._rigid].T + rows.of_u @ self._forced
        if rows.of_v is not None:
            out += speed @ rows.of_v[:, self._rigid].T
        alive = self._alive(rows, float(t[0]))
        for first in range(0, len(t) if len(alive) else 0, CHUNK):
            part = slice(first, first + CHUNK)
            for power, amount in self._waves():
                wave = amount[alive] * np.exp(np.multiply.outer(t[part], power[alive]))
                out[part] += (wave @ rows.along(power)[:, alive].T).real
        return np.asarray(out)

    def _waves(self) -> tuple[tuple[Complex, Complex], ...]:
        """Exponents and amounts of the two exponentials of every mode."""
        return (self._fast, self._fast_part), (self._slow, self._slow_part)

    def _sway(self, rows: Rows, t: float) -> Array:
        """How far each elastic mode (n,) can still move any of ``rows``, ``t`` after the start."""
        size = np.zeros(len(self._rigid))
        for power, amount in self._waves():
            reach = np.abs(rows.along(power)).max(axis=0)
            size += reach * np.abs(amount) * np.exp(power.real * t)
        return np.where(self._rigid, 0.0, size)

    def _alive(self, rows: Rows, t: float) -> NDArray[np.intp]:
        """The elastic modes that still matter to ``rows``, ``t`` after the start."""
        return np.flatnonzero(self._sway(rows, t) > NEGLIGIBLE_M)

    def ringing(self, rows: Rows, t_s: Array) -> Array:
        """A bound (k,) in m on how far ringing moves any of ``rows`` from ``t_s`` (k,) on."""
        t = np.asarray(t_s) - self.t0_s
        alive = self._alive(rows, float(t[0]))
        bound = np.zeros_like(t)
        for power, amount in self._waves():
            reach = np.abs(rows.along(power)[:, alive]).max(axis=0, initial=0.0)
            decay = np.exp(np.multiply.outer(t, power[alive].real))
            bound += decay @ (reach * np.abs(amount[alive]))
        return bound

    def _sampling_s(self, rows: Rows, start_s: float) -> float:
        """A time step that resolves the fastest oscillation that matters from ``start_s`` on."""
        sway = self._sway(rows, start_s - self.t0_s)
        loud = sway > max(1e-3 * sway.max(initial=0.0), NEGLIGIBLE_M)
        fastest = np.abs(self._fast.imag[loud]).max(initial=0.0)
        return float(2.0 * np.pi / fastest / SAMPLES_PER_PERIOD) if fastest > 0.0 else np.inf

    def _ballistic(self, t: Array, row: Array) -> Array:
        """Height of the rigid motion along ``row`` (n,) at times ``t`` after the start."""
        return np.asarray(self._fall(t, self._rigid)[0] @ row[self._rigid])

    def next_touch(self, rows: Rows, until_s: float) -> float | None:
        """The first time in (t0, ``until_s``] at which a row comes down through zero, or None.

        A row that starts below zero, on its way up, touches when it turns down before it got out.
        """
        if until_s <= self.t0_s:
            return None
        above = False
        for start, end in self._windows(rows, until_s):
            above = above or start > self.t0_s
            step = min(self._sampling_s(rows, start), (end - start) / 8.0)
            count = int(np.ceil((end - start) / step)) + 1
            for first in range(0, count - 1, CHUNK):
                t = start + step * np.arange(first, min(first + CHUNK, count - 1) + 1)
                low = self._lowest(rows, t)
                for i in range(len(t) - 1):
                    above = above or low[i] > 0.0
                    if above and low[i + 1] <= 0.0:
                        left = t[i] if low[i] > 0.0 else t[i] - step
                        return self._root(rows, left, t[i + 1])
                    if not above and low[i + 1] < low[i]:
                        return float(t[i + 1])
        return None

    def _lowest(self, rows: Rows, t: Array) -> Array:
        return np.asarray(self.observe(rows, t).min(axis=1))

    def _root(self, rows: Rows, left: float, right: float) -> float:
        def lowest(t: float) -> float:
            return float(self._lowest(rows, np.array([t]))[0])

        if lowest(right) == 0.0:
            return right
        if lowest(left) <= 0.0:
            return left
        return float(brentq(lowest, left, right, xtol=1e-16, rtol=8.9e-16))

    def _windows(self, rows: Rows, until_s: float) -> list[tuple[float, float]]:
        """Intervals in which ringing could bring a row down to zero."""
        grid = np.linspace(0.0, until_s - self.t0_s, 513)
        height = self._fall(grid, self._rigid)[0] @ rows.of_u[:, self._rigid].T
        slack = self.ringing(rows, self.t0_s + grid)
        near = height.min(axis=1) <= 2.0 * slack + 1e-12
        # the parabola may cross zero between two grid points: take the neighbours in
        near |= np.concatenate([near[1:], [False]]) | np.concatenate([[False], near[:-1]])
        near[0] = True
        windows: list[tuple[float, float]] = []
        for i in np.flatnonzero(near[:-1] & near[1:]):
            a, b = self.t0_s + grid[i], self.t0_s + grid[i + 1]
            if windows and windows[-1][1] == a:
                windows[-1] = (windows[-1][0], b)
            else:
                windows.append((a, b))
        return windows

    def apex(self, row: Array, until_s: float) -> tuple[float, float]:
        """Time and height of the highest point of ``row`` (n,) in [t0, ``until_s``]."""
        rows = Rows(row[None, :])
        grid = np.linspace(0.0, until_s - self.t0_s, 513)
        height = self._ballistic(grid, row)
        slack = self.ringing(rows, self.t0_s + grid)
        best = (height - slack).max()
        spacing = grid[1] - grid[0]
        slope = np.abs(np.diff(height)).max(initial=0.0)
        near = np.flatnonzero(height + slack >= best - slope)
        start = max(grid[near[0]] - spacing, 0.0)
        end = min(grid[near[-1]] + spacing, grid[-1])
        step = min(self._sampling_s(rows, self.t0_s + start), (end - start) / 64.0)
        t = self.t0_s + np.linspace(start, end, int(np.ceil((end - start) / step)) + 1)
        seen = self.observe(rows, t)[:, 0]
        i = int(np.argmax(seen))
        lower, upper = t[max(i - 1, 0)], t[min(i + 1, len(t) - 1)]
        found = minimize_scalar(
            lambda x: -float(self.observe(rows, np.array([x]))[0, 0]),
            bounds=(lower, upper),
            method="bounded",
            options={"xatol": 1e-12},
        )
        if -found.fun > seen[i]:
            return float(found.x), float(-found.fun)
        return float(t[i]), float(seen[i])
