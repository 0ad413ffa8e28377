"""Contact forces of one step: Newton's method, and the fallbacks where it fails."""

from __future__ import annotations

import math

import numpy as np

from ..compiled import njit
from .normal import HELD, HELD_FAST, LETTING_GO, holds
from .points import Points, Trial, changed
from .section import Section, solve_section

# Number of stages in `_solve_by_stiffening`, and the factor between them.
STIFFENING_STAGES, STIFFENING = 8, 3.0
AUGMENTATION_LIMIT = 200
MULTIPLIER_TOLERANCE = 1e-9
# An update of the multiplier that leaves more than `SLOW_UPDATE` of the last change is slow. The
# proximal compliance then shrinks by `SHRUNK`, down to `SMALLEST` of itself: rounding of an
# approach, over the proximal compliance, must stay below what Newton's method resolves.
SLOW_UPDATE, SHRUNK, SMALLEST = 0.5, 0.25, 1.0 / 64.0


@njit
def _solve_by_stiffening(points: Points, section: Section, trial: Trial) -> int:
    """As `solve_section`, with friction's springs stiffened in stages.

    The range between sliding one way and the other is so narrow for a stiff spring that Newton's
    method may jump across it for ever. Each stage starts from the solution with a softer spring.
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
    """As `solve_section`, with adhesion first unlimited; overloaded points then let go.

    Letting go reduces the force as the approach goes on. So a step may have several solutions, and
    Newton's method may jump between them. Here each point lets go at most once.
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
    """Write the ``trial``'s force and its approach at the end; returns the number of iterations.

    The augmented Lagrangian's multiplier is updated until it equals the force. An update changes
    the forces, and leaves an error of the approaches equal to the proximal compliance times that
    change. Updates stop at the share `MULTIPLIER_TOLERANCE`: either no force changes by more than
    it times the largest, or no approach errs by more than it times the points' motion without
    contact. Either way the work of the step is accurate to that share. The second criterion serves
    force patterns to which the body hardly responds, as on a fine section. Returns minus one if
    Newton's method fails, minus two if the updates do not converge.
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
