"""Second-order coupling of axial force and bending in a slender body.

The force on a leaning bristle is far above its static buckling load. So its moment about the
deflected axis matters even within one impact. To second order in the slope the axial strain is von
Kármán's, u' + ½ (w_x'² + w_y'²), which couples bending with axial motion. The strain energy beyond
the linear one is

    ½ Σ E A Δz ((e + q)² - e²),    e = u',  q = ½ (w_x'² + w_y'²).

Damping by β acts on the rate of that strain. Beyond the linear body it dissipates
β Σ E A Δz ((ė + q̇)² - ė²), which is nothing in an axis that shortens as it bends freely.

A loss factor η damps modes, so it cannot act on strains at points. The strained part of u is u less
the axis' static response to the strain -q, which is -K⁻¹ Eᵀ b with E the rows of e and b = EAΔz q.
The loss factor damps its rate by the matrix C, which is η ω in modes. With R = E K⁻¹ C and
H = R K⁻¹ Eᵀ it dissipates 2 (R u̇) · ḃ + ḃ · H ḃ beyond the linear body.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..compiled import njit


@dataclass(frozen=True)
class Axis:
    """Rows over a body's unknowns at points of its axis: axial ``strain``, ``slope_x`` and
    ``slope_y`` (g, dofs), and ``weights_N_m`` (g,), E A times each point's share of the length."""

    strain: Array
    slope_x: Array
    slope_y: Array
    weights_N_m: Array

    def in_modes(self, modes: Array) -> Axis:
        """The rows over the coordinates of ``modes`` (dofs, m)."""
        return Axis(
            self.strain @ modes, self.slope_x @ modes, self.slope_y @ modes, self.weights_N_m
        )


class Shortening(NamedTuple):
    """The axis for compiled code: the rows stacked (3 g, modes), with a loss factor those of R
    below them (4 g, modes); 1/ω² (modes,), zero for rigid modes; β in s; H (g, g). A linear body
    has no rows."""

    rows: Array
    weights: Array
    flexibility: Array
    beta_s: float
    lossy: Array


def shortening(
    axis: Axis | None, omega2: Array, beta_s: float = 0.0, loss_factor: float = 0.0
) -> Shortening:
    """The tables of an ``axis``, or empty ones."""
    soft = np.divide(1.0, omega2, out=np.zeros_like(omega2), where=omega2 > 0.0)
    if axis is None:
        none = np.zeros((0, 0))
        return Shortening(np.zeros((0, len(omega2))), np.zeros(0), 0.0 * soft, beta_s, none)
    lost = axis.strain * (loss_factor * np.sqrt(soft))
    rows = [axis.strain, axis.slope_x, axis.slope_y, *([lost] if loss_factor else [])]
    return Shortening(
        rows=np.ascontiguousarray(np.vstack(rows)),
        weights=np.asarray(axis.weights_N_m, dtype=float),
        flexibility=soft,
        beta_s=beta_s,
        lossy=np.ascontiguousarray((lost * soft) @ axis.strain.T),
    )


@njit
def _lossy(axis: Shortening, before: Array, after: Array, its: float) -> tuple[Array, Array]:
    """Strain of the axis by bending over a step, and the axial force of the loss factor, in N m
    (g,)."""
    g = len(axis.weights)
    bent = np.zeros(g)
    if len(before) == 3 * g:
        return bent, bent
    for i in range(g):
        x0, y0, x1, y1 = before[g + i], before[2 * g + i], after[g + i], after[2 * g + i]
        bent[i] = 0.5 * axis.weights[i] * ((x1 - x0) * (x0 + x1) + (y1 - y0) * (y0 + y1))
    strained = after[3 * g :] - before[3 * g :] + axis.lossy @ bent
    return bent, axis.weights * strained / its


@njit
def _mean_strain(
    axis: Shortening, before: Array, after: Array, its: float, i: int
) -> tuple[float, float, float, float]:
    """At point ``i`` over a step of ``its`` s, with the rates for damping: the linear part of the
    strain, the part of bending, and the slopes at mid-step."""
    g, viscous = len(axis.weights), axis.beta_s / its
    x0, y0, x1, y1 = before[g + i], before[2 * g + i], after[g + i], after[2 * g + i]
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    bent = 0.25 * (x0 * x0 + y0 * y0 + x1 * x1 + y1 * y1)
    bent += viscous * (x * (x1 - x0) + y * (y1 - y0))
    linear = 0.5 * (before[i] + after[i]) + viscous * (after[i] - before[i])
    return linear, bent, x, y


@njit
def second_order_force(axis: Shortening, before: Array, after: Array, its: float) -> Array:
    """Force (modes,) over a step of ``its`` s, from the second-order energy and its damping.

    ``before`` and ``after`` (3 g,) are rows @ u at its ends. It is the discrete gradient of the
    energy (Simo and Tarnow, ZAMP 43, 1992: mean strain, slope at mid-step), so energy is conserved.
    """
    g = len(axis.weights)
    pull = np.empty(len(before))
    lossy, tension = _lossy(axis, before, after, its)
    pull[3 * g :] = -lossy[: len(before) - 3 * g] / its
    for i in range(g):
        linear, bent, x, y = _mean_strain(axis, before, after, its, i)
        force = axis.weights[i] * (linear + bent) + tension[i]
        pull[i] = -axis.weights[i] * bent
        pull[g + i] = -force * x
        pull[2 * g + i] = -force * y
    return axis.rows.T @ pull


@njit
def second_order_tangent(axis: Shortening, before: Array, after: Array, its: float) -> Array:
    """Derivative (modes, modes) of `second_order_force` by u at the end of the step."""
    g, rate = len(axis.weights), 0.5 + axis.beta_s / its
    pull = np.zeros_like(axis.rows)
    tension = _lossy(axis, before, after, its)[1]
    slope_x, slope_y = axis.rows[g : 2 * g], axis.rows[2 * g : 3 * g]
    if len(pull) > 3 * g:
        for i in range(g):
            bending = after[g + i] * slope_x[i] + after[2 * g + i] * slope_y[i]
            pull[3 * g + i] = -axis.weights[i] / its * bending
        strained = (axis.rows[3 * g :] - its * axis.lossy @ pull[3 * g :]) / its
        for i in range(g):
            x, y = (
                0.5 * (before[g + i] + after[g + i]),
                0.5 * (before[2 * g + i] + after[2 * g + i]),
            )
            pull[g + i] = -axis.weights[i] * x * strained[i]
            pull[2 * g + i] = -axis.weights[i] * y * strained[i]
    for i in range(g):
        linear, bent, x, y = _mean_strain(axis, before, after, its, i)
        force, stiff = axis.weights[i] * (linear + bent) + tension[i], axis.weights[i] * rate
        for j in range(axis.rows.shape[1]):
            across_x, across_y = slope_x[i, j], slope_y[i, j]
            bending = stiff * (after[g + i] * across_x + after[2 * g + i] * across_y)
            change = stiff * axis.rows[i, j] + bending
            pull[i, j] = -bending
            pull[g + i, j] += -change * x - 0.5 * force * across_x
            pull[2 * g + i, j] += -change * y - 0.5 * force * across_y
    return axis.rows.T @ pull


@njit
def second_order_loss(axis: Shortening, before: Array, after: Array, its: float) -> float:
    """Energy dissipated over a step beyond the linear body's, in J."""
    g, total = len(axis.weights), 0.0
    for i in range(g):
        x0, y0, x1, y1 = before[g + i], before[2 * g + i], after[g + i], after[2 * g + i]
        bent = 0.5 * ((x1 - x0) * (x0 + x1) + (y1 - y0) * (y0 + y1))
        total += axis.weights[i] * (2.0 * (after[i] - before[i]) + bent) * bent
    lossy, tension = _lossy(axis, before, after, its)
    taken = axis.beta_s / its * total
    for i in range(len(before) - 3 * g):
        taken += lossy[i] * (
            tension[i] / axis.weights[i] + (after[3 * g + i] - before[3 * g + i]) / its
        )
    return taken


@njit
def shortened(axis: Shortening, u: Array, v: Array) -> tuple[Array, Array]:
    """Change of (u, v) that shortens the axis by its slopes without straining it.

    Slopes leave the length of a linear body unchanged; one of second order that bends freely
    shortens by ∫ q. The change is the static response of the axis to the strain -q.
    """
    g = len(axis.weights)
    values, speed = axis.rows @ u, axis.rows @ v
    pull, push = np.zeros(len(values)), np.zeros(len(values))
    for i in range(g):
        x, y = values[g + i], values[2 * g + i]
        pull[i] = -axis.weights[i] * 0.5 * (x * x + y * y)
        push[i] = -axis.weights[i] * (x * speed[g + i] + y * speed[2 * g + i])
    return axis.flexibility * (axis.rows.T @ pull), axis.flexibility * (axis.rows.T @ push)
