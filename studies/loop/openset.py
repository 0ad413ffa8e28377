"""Is anything left after the best refit, and do two effects explain what one does not?

The same family of statistics looks at the residuals of the refitted model, with values simulated
from it and refitted as the measured ones were; the directions of the other candidates are among
the tests, so that a second known effect is not overlooked. Two effects are believed only if each
is needed beside the other and nothing is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...solver.bristle import Array
from .detect import kept_noises, refit, simulate
from .family import corrected, family, p_values
from .fit import Fitted, settle, to_box
from .ladder import Ladder
from .posterior import Posterior, posterior
from .problem import Problem
from .sample import Sample

SETS = 299
PAIRS_TRIED = 6
DIRECTION_D = 6.0


@dataclass(frozen=True)
class Left:
    """``p_value`` of what is left, corrected for all tests; which ``statistic`` is the smallest;
    ``residual`` (rows,) standardised; ``table`` of (test, value, p-value alone)."""

    p_value: float
    statistic: str
    residual: Array
    table: tuple[tuple[str, float, float], ...]


def directions(base: Fitted, ladders: Sequence[Ladder]) -> tuple[list[str], Array]:
    """One mean direction per ray (directions, rows) at a moderate size, and whose it is."""
    names: list[str] = []
    out: list[Array] = []
    for each in ladders:
        shift = each.mean() - base.mean
        for ray in np.unique(each.ray):
            mine = np.flatnonzero(each.ray == ray)
            point = mine[np.argmin(np.abs(each.d[mine] - DIRECTION_D))]
            if np.linalg.norm(shift[point]) > 0.5:
                names.append(each.name)
                out.append(shift[point])
    return names, np.array(out).reshape(-1, base.mean.size)


def left_over(
    data: Sample,
    fit_: Posterior,
    base: Fitted,
    ladders: Sequence[Ladder],
    rng: np.random.Generator,
    sets: int = SETS,
) -> Left:
    """Test what a refitted model leaves."""
    fitted = fit_.fitted
    among = kept_noises(data, fit_.shares)
    spread = np.sqrt(1 + fitted.spread**2)
    values = np.concatenate(
        [data.values[None], simulate(data, fitted, fit_.shares, among, sets, rng)]
    )
    slopes = fitted.mean_slopes / spread[:, None]
    found = refit(data, (values - fitted.mean) / spread, slopes, among)
    tests = family(data)
    columns = [tests(found.standard)]
    names = list(tests.names)
    owners, shifts = directions(base, [x for x in ladders if x.name not in fitted.effects])
    if owners:
        project = np.eye(slopes.shape[0]) - slopes @ np.linalg.pinv(slopes)
        unit = (shifts / spread) @ project
        norm = np.linalg.norm(unit, axis=1)
        unit /= np.maximum(norm, 1e-9)[:, None]
        loads = np.maximum(found.standard @ unit.T, 0.0) ** 2 * (norm > 0.3)
        for name in dict.fromkeys(owners):
            mine = [k for k, owner in enumerate(owners) if owner == name]
            columns.append(loads[:, mine].max(axis=1, keepdims=True))
            names.append(name)
    table = np.concatenate(columns, axis=1)
    single, simulated = p_values(table[0], table[1:])
    p_value, _ = corrected(single, simulated)
    return Left(
        p_value=p_value,
        statistic=names[int(np.argmin(single))],
        residual=found.residual[0],
        table=tuple(
            (name, float(v), float(p)) for name, v, p in zip(names, table[0], single, strict=True)
        ),
    )


def likely_pairs(
    data: Sample, base: Fitted, ladders: Sequence[Ladder], singles: Sequence[Posterior]
) -> list[tuple[str, str]]:
    """Pairs whose directions together, each in its own sense, fit the baseline's residuals best.

    The three likeliest effects alone with every other, and the pairs that add up best at all.
    """
    owners, shifts = directions(base, ladders)
    slopes = base.mean_slopes
    project = np.eye(slopes.shape[0]) - slopes @ np.linalg.pinv(slopes)
    along = shifts @ project
    gram = along @ along.T
    target = along @ (data.values - base.mean)
    gain: dict[tuple[str, str], float] = {}
    for i in range(len(owners)):
        for j in range(i + 1, len(owners)):
            if owners[i] == owners[j]:
                continue
            found = _two(gram[i, i], gram[j, j], gram[i, j], target[i], target[j])
            key = (owners[i], owners[j])
            gain[key] = max(gain.get(key, 0.0), found)
    best = {name: each.log_evidence for name, each in _named(singles)}
    scatter = {x.name for x in ladders if np.asarray(x.model.weights).size > 1}
    likeliest = sorted(best, key=lambda name: -best[name])[:3]
    for name in scatter:
        for other in likeliest:
            if name != other and not scatter & {name} - {name}:
                key = next((k for k in gain if set(k) == {name, other}), (name, other))
                gain[key] = max(gain.get(key, 0.0), best[other] + best[name])
    order = sorted(gain, key=lambda key: (-gain[key], key))
    return [key for key in order if gain[key] > 0][:PAIRS_TRIED]


def _named(singles: Sequence[Posterior]) -> list[tuple[str, Posterior]]:
    return [(each.fitted.effects[0], each) for each in singles]


def _two(aa: float, bb: float, ab: float, ta: float, tb: float) -> float:
    """Gain in log likelihood from two directions with amounts that are not negative; zero unless
    both are wanted."""
    det = aa * bb - ab**2
    if det < 1e-6 * aa * bb:
        return 0.0
    a, b = (bb * ta - ab * tb) / det, (aa * tb - ab * ta) / det
    return 0.5 * (a * ta + b * tb) if a > 0 and b > 0 else 0.0


def pair(
    problem: Problem,
    data: Sample,
    base: Fitted,
    names: tuple[str, str],
    singles: Sequence[Posterior],
    ladders: Sequence[Ladder],
    rng: np.random.Generator,
) -> Posterior:
    """Refit two effects at once, from what each was alone, halves of it, and a small one."""
    model = problem.combine(names)
    alone = dict(_named(singles))
    own = base.u.size
    best = max(names, key=lambda name: alone[name].log_evidence)
    starts = []
    for share in ((1.0, 1.0), (0.7, 0.7), (1.0, 0.3)):
        parts = [base.u if share[1] < 1 else alone[best].fitted.u[:own]]
        for name in model.effects:
            fitted = alone[name].fitted
            null = np.array([to_box(e, e.null) for e in fitted.model.parameters[own:]])
            amount = share[0] if name == best else share[1]
            parts.append(null + amount * (fitted.u[own:] - null))
        starts.append(np.concatenate(parts))
    rungs = {each.name: each for each in ladders}
    small = [base.u]
    for name in model.effects:
        each = rungs[name]
        small.append(each.u[int(np.argmin(np.abs(each.d - DIRECTION_D))), own:])
    starts.append(np.concatenate(small))
    fitted, shares = settle(data, model, np.array(starts), alone[best].fitted.noise)
    return posterior(data, base, fitted, shares, rng)
