"""Contact forces of one step: Newton's method, and what is tried where it fails."""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from .normal import HELD, HELD_FAST, LETTING_GO, holds
from .points import Points, Trial
from .section import Section, solve_section

# Stages, and the factor between them, of `_solve_by_stiffening`.
STIFFENING_STAGES, STIFFENING = 8, 3.0
AUGMENTATION_LIMIT = 200
MULTIPLIER_TOLERANCE = 1e-9
# Of an approach that some sums of four products make.
ROUNDING = 1e-14


@njit
def _solve_by_stiffening(points: Points, section: Section, trial: Trial) -> int:
    """As `solve_section`, friction's springs brought to their stiffness in stages.

    A stiff spring has so narrow a zone between sticking and sliding either way that Newton's method
    may jump across it for ever; each stage starts where a softer one ended.
    """
    total = 0
    for stage in range(STIFFENING_STAGES, -1, -1):
        eased = Points(
            kind=points.kind,
            law=points.law,
            kt=points.kt * STIFFENING**-stage,
            mu=points.mu,
            scale=points.scale,
            compliance=points.compliance,
            weights=points.weights,
            end_weight=points.end_weight,
            proximal=points.proximal,
            dashpot=points.dashpot,
        )
        section.predictor[1, :] = 0.0
        done = solve_section(eased, section, trial)
        if done < 0:
            return -1
        total += done
    return total


@njit
def _solve_held(points: Points, section: Section, trial: Trial) -> int:
    """As `solve_section`, adhesion first holding without limit; then what it cannot hold lets go.

    Letting go makes the force fall as the approach goes on, so a step may have several answers and
    Newton's method jump between them. Which points let go is decided here, once for each.
    """
    n = len(points.weights)
    memory = trial.memory
    total = 0
    for i in range(n):
        if memory[i, 2] == HELD:
            memory[i, 2] = HELD_FAST
    for _ in range(n + 1):
        section.predictor[:] = 0.0
        done = solve_section(points, section, trial)
        if done < 0:
            total = -1
            break
        total += done
        more = False
        for i in range(n):
            reach = points.law[1] / (points.scale[i] * points.law[0])
            if memory[i, 2] == HELD_FAST and trial.end[i, 0] <= -reach:
                memory[i, 2] = LETTING_GO
                more = True
        if not more:
            break
    for i in range(n):
        if memory[i, 2] > HELD:
            memory[i, 2] = HELD
    return total


@njit
def solve_step(points: Points, section: Section, trial: Trial) -> int:
    """Write the ``trial``'s force and its approach at the end; returns the iterations.

    Under an augmented Lagrangian its multiplier is updated until it is the force itself: until an
    update changes no force by more than `MULTIPLIER_TOLERANCE` of the largest, or no approach by
    more than rounding. Minus one where Newton's method fails, minus two where the updates take too
    long.
    """
    total = 0
    force, multiplier = trial.force, trial.multiplier
    for _ in range(AUGMENTATION_LIMIT):
        done = solve_section(points, section, trial)
        if done < 0 and points.mu > 0.0 and not math.isinf(points.kt):
            done = _solve_by_stiffening(points, section, trial)
        if done < 0 and holds(points, trial.memory):
            done = _solve_held(points, section, trial)
        if done < 0:
            return -1
        total += done
        if points.proximal == 0.0:
            return total
        change = np.abs(force - multiplier).max()
        multiplier[:, :] = force
        resolved = ROUNDING * np.abs(trial.free).max() / points.proximal
        if change <= max(MULTIPLIER_TOLERANCE * np.abs(force).max(), resolved):
            return total
    return -2
