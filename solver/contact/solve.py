"""Contact forces of one step: Newton's method, and what is tried where it fails."""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from .normal import HELD, HELD_FAST, LETTING_GO, holds
from .points import Points, Trial, changed
from .section import Section, solve_section

# Stages, and the factor between them, of `_solve_by_stiffening`.
STIFFENING_STAGES, STIFFENING = 8, 3.0
AUGMENTATION_LIMIT = 200
MULTIPLIER_TOLERANCE = 1e-9
# An update that leaves more than this share of the one before is slow. The proximal compliance then
# shrinks by the factor, down to this part of itself: rounding of an approach, over the proximal
# compliance, must stay below what Newton's method resolves.
SLOW_UPDATE, SHRUNK, SMALLEST = 0.5, 0.25, 1.0 / 64.0


@njit
def _solve_by_stiffening(points: Points, section: Section, trial: Trial) -> int:
    """As `solve_section`, friction's springs brought to their stiffness in stages.

    A stiff spring has so narrow a zone between sticking and sliding either way that Newton's method
    may jump across it for ever; each stage starts where a softer one ended.
    """
    total = 0
    for stage in range(STIFFENING_STAGES, -1, -1):
        kt = points.kt * STIFFENING**-stage
        eased = changed(
            points, points.law, kt, points.mu, points.scale, points.proximal, points.dashpot
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

    Under an augmented Lagrangian its multiplier is updated until it is the force itself. An update
    changes forces, and leaves approaches as far from the law as the proximal compliance times that
    change. It is the last where no force changes by more than `MULTIPLIER_TOLERANCE` of the
    largest, or no approach is farther off than that share of how far the points would move without
    contact: either way the work of the step is right to that share. The second is for patterns of
    force to which the body hardly answers, as it does to some on a fine section. Minus one where
    Newton's method fails, minus two where the updates take too long.
    """
    total, axes = 0, 3 if points.mu > 0.0 else 1
    force, multiplier = trial.force, trial.multiplier
    proximal, least, before = points.proximal, SMALLEST * points.proximal, math.inf
    for _ in range(AUGMENTATION_LIMIT):
        at = changed(
            points, points.law, points.kt, points.mu, points.scale, proximal, points.dashpot
        )
        done = solve_section(at, section, trial)
        if done < 0 and points.mu > 0.0 and not math.isinf(points.kt):
            done = _solve_by_stiffening(at, section, trial)
        if done < 0 and holds(points, trial.memory):
            done = _solve_held(at, section, trial)
        if done < 0 and proximal < points.proximal:
            least = proximal = points.proximal
            continue
        if done < 0:
            return -1
        total += done
        if points.proximal == 0.0:
            return total
        change = np.abs(force - multiplier).max()
        multiplier[:, :] = force
        answered = np.abs(trial.free[:, :axes] - trial.start[:, :axes]).max() / proximal
        if change <= MULTIPLIER_TOLERANCE * max(np.abs(force).max(), answered):
            return total
        if change > SLOW_UPDATE * before and proximal > least:
            proximal *= SHRUNK
            section.factored[0] = False
        before = change
    return -2
