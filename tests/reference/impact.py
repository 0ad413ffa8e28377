"""What every reference program is asked, and what it answers.

The physics is one upright impact: a free steel bar, elastic with damping C = β K of the material
alone, falls on a unilateral spring of stiffness Kn spread evenly over its end face, under gravity.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bristle.solver import paper

Array = NDArray[np.floating]
AREA_M2 = paper.THICKNESS_M * paper.WIDTH_M
MASS_KG = paper.DENSITY_KG_M3 * AREA_M2 * paper.LENGTH_M


@dataclass(frozen=True)
class Impact:
    """One impact: cells along the thin side, the wide side and the length, the degree of the
    elements, and the rest in SI units. The march ends ``until_s`` after the first touch."""

    cells: tuple[int, int, int] = (1, 2, 42)
    order: int = 2
    its_s: float = paper.ITS_S
    kn_N_m: float = paper.KN_CHOSEN_N_M
    height_m: float = 0.05
    beta_s: float = paper.BETA_S
    until_s: float = 2.5e-4

    @property
    def t_s(self) -> Array:
        """The ends of equal steps (n,)."""
        return self.its_s * np.arange(1, math.ceil(self.until_s / self.its_s - 1e-9) + 1)

    @property
    def speed_m_s(self) -> float:
        return math.sqrt(2.0 * paper.GRAVITY_M_S2 * self.height_m)


@dataclass(frozen=True)
class March:
    """What a march saw at the ends of its steps: time, contact force, height of the tip."""

    t_s: Sequence[float]
    force_N: Sequence[float]
    tip_m: Sequence[float]
    n_dofs: int


def asked(description: str, arguments: Sequence[str] | None) -> Impact:
    """The impact that the command line asks for."""
    usual = Impact()
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--cells", type=int, nargs=3, default=usual.cells)
    parser.add_argument("--order", type=int, choices=(1, 2), default=usual.order)
    for name in ("its_s", "kn_N_m", "height_m", "beta_s", "until_s"):
        option = f"--{name.partition('_')[0]}"
        parser.add_argument(option, dest=name, type=float, default=getattr(usual, name))
    given = vars(parser.parse_args(arguments))
    return Impact(**{**given, "cells": tuple(given["cells"])})


def answer(impact: Impact, march: March) -> dict[str, float | int]:
    """y1/y0 of the centre of mass, contact time, peak force and the steps that they took.

    The centre moves by the contact force and gravity alone. Newmark's average acceleration moves
    it in every one of these programs, so that summing the force up by it is no further error.
    """
    t, force = np.asarray(march.t_s), np.asarray(march.force_N)
    h = np.diff(t, prepend=0.0)
    acceleration = np.concatenate([[0.0], force]) / MASS_KG - paper.GRAVITY_M_S2
    mean = 0.5 * (acceleration[1:] + acceleration[:-1])
    speed = np.concatenate([[0.0], np.cumsum(h * mean)]) - impact.speed_m_s
    height = float(np.sum(0.5 * h * (speed[1:] + speed[:-1])))
    top = height + math.copysign(speed[-1] ** 2, speed[-1]) / (2.0 * paper.GRAVITY_M_S2)
    return {
        "rebound_ratio": float(top / impact.height_m),
        "contact_time_s": _release_s(t, np.asarray(march.tip_m), force),
        "peak_force_N": float(force.max()),
        "n_steps": len(force),
        "n_dofs": march.n_dofs,
    }


def _release_s(t_s: Array, tip_m: Array, force_N: Array) -> float:
    """When the tip left for good, by a straight line through the step in which it did."""
    last = int(np.flatnonzero(force_N > 0.0)[-1])
    if last + 1 == len(force_N):
        raise SystemExit("the tip is still in contact at the end; give a longer --until")
    share = -tip_m[last] / (tip_m[last + 1] - tip_m[last])
    return float(t_s[last] + share * (t_s[last + 1] - t_s[last]))


def run(
    description: str, march: Callable[[Impact], March], arguments: Sequence[str] | None = None
) -> int:
    """March the impact that was asked for and print one line of JSON; the exit status."""
    impact = asked(description, arguments)
    started = time.perf_counter()
    marched = march(impact)
    found = answer(impact, marched)
    found["wall_s"] = time.perf_counter() - started
    found["peak_rss_MB"] = _peak_rss_MB()
    print(json.dumps(found))
    return 0


def _peak_rss_MB() -> float:
    """Of this process and of any that it waited for."""
    spent = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return max(each.ru_maxrss for each in spent) * 1024 / 1e6
