"""Limit of a quantity as the time step shrinks, and the longest step near enough to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from ...solver.analytic import quarter_period_s
from ...solver.arrays import Array

CASE = ["model", "kn_N_m", "y0_m", "quantity"]
ERRORS = [*CASE, "its_s", "value", "converged", "order", "error_relative"]
NEEDS = [*CASE, "goal", "its_needed_s", "bound", "rule_s"]
# Orders of which extrapolation is trusted: none of the schemes has another.
ORDERS = (0.8, 2.5)


@dataclass(frozen=True)
class Limit:
    """What a quantity converges to; ``order`` is None where it was not clean enough to use."""

    value: float
    order: float | None


def limit(its_s: Array, values: Array) -> Limit:
    """Richardson's extrapolation from the three shortest steps, or the value at the shortest.

    ``its_s`` (n,) and ``values`` (n,) in any order. The order p solves
    (f₃ - f₂) / (f₂ - f₁) = (h₃ᵖ - h₂ᵖ) / (h₂ᵖ - h₁ᵖ) for h₁ < h₂ < h₃; it must lie in ``ORDERS``,
    and what is added must be smaller than the last change.
    """
    order = np.argsort(its_s)
    h, f = np.asarray(its_s, float)[order], np.asarray(values, float)[order]
    p = _order(h[:3], f[:3]) if len(h) >= 3 else None
    if p is None:
        return Limit(float(f[0]), None)
    slope = (f[1] - f[0]) / (h[1] ** p - h[0] ** p)
    return Limit(float(f[0] - slope * h[0] ** p), p)


def _order(h: Array, f: Array) -> float | None:
    near, far = f[1] - f[0], f[2] - f[1]
    round_off = 1e-12 * np.abs(f).max()
    if abs(near) <= round_off or far / near <= 0.0:
        return None

    def excess(p: float) -> float:
        return float((h[2] ** p - h[1] ** p) / (h[1] ** p - h[0] ** p) - far / near)

    low, high = ORDERS
    if excess(low) * excess(high) > 0.0:
        return None
    return float(brentq(excess, low, high))


@dataclass(frozen=True)
class Need:
    """The longest step that keeps an error small: ``its_s``, or a bound on it.

    ``bound`` is "" for a value between two steps that were computed, ">=" where the longest of
    them is short enough, "<" where the shortest is not.
    """

    its_s: float
    bound: str


def need(its_s: Array, errors: Array, goal: float) -> Need:
    """The longest step up to which every |error| stays below ``goal``, between steps by powers.

    ``its_s`` (n,) and relative ``errors`` (n,) in any order; NaN counts as too large.
    """
    order = np.argsort(its_s)
    h, e = np.asarray(its_s, float)[order], np.abs(np.asarray(errors, float))[order]
    bad = np.flatnonzero(~(e <= goal))
    if not len(bad):
        return Need(float(h[-1]), ">=")
    first = int(bad[0])
    if first == 0:
        return Need(float(h[0]), "<")
    good_e, bad_e = max(e[first - 1], 1e-3 * goal), e[first]
    if not math.isfinite(bad_e):
        return Need(float(h[first - 1]), ">=")
    share = math.log(goal / good_e) / math.log(bad_e / good_e)
    return Need(float(h[first - 1] * (h[first] / h[first - 1]) ** share), "")


def shortest(its_s: Array, values: Array) -> Limit:
    """The value at the shortest step, for what is too rough to extrapolate."""
    return Limit(float(values[np.argmin(its_s)]), None)


def compare(
    drops: pd.DataFrame,
    quantities: Iterable[str],
    goal: float,
    mass_kg: float,
    converged: Callable[[Array, Array], Limit] = limit,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The error of every step, and the step that each quantity needs (`need`) beside Eq. 8.

    Of ``drops`` those of one model, Kn and height differ in ITS alone; quantities that are not
    known of any of them are left out, and an unknown one is too far off. Where ``converged`` is the
    `shortest` step, that has no row.
    """
    errors: list[tuple[Any, ...]] = []
    needs: list[tuple[Any, ...]] = []
    for key, members in drops.groupby(["model", "kn_N_m", "y0_m"], sort=False):
        for name in quantities:
            its_s, values = members.its_s.to_numpy(), members[name].to_numpy(float)
            known = ~np.isnan(values)
            if not known.any():
                continue  # no rebound was asked for
            found = converged(its_s[known], values[known])
            error = values / found.value - 1.0
            kept = its_s > (its_s[known].min() if converged is shortest else 0.0)
            errors += [
                (*key, name, step, value, found.value, found.order, e)
                for step, value, e in zip(its_s[kept], values[kept], error[kept], strict=True)
            ]
            longest = need(its_s[kept], error[kept], goal)
            rule = quarter_period_s(mass_kg, key[1])
            needs.append((*key, name, goal, longest.its_s, longest.bound, rule))
    return pd.DataFrame(errors, columns=ERRORS), pd.DataFrame(needs, columns=NEEDS)
