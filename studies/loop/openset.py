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
from .fit import Fitted, settle, to_box, to_theta
from .ladder import Ladder
from .noise import influence, score_table
from .posterior import Posterior, posterior
from .problem import Problem
from .sample import Sample

SETS = 299
PAIRS_TRIED = 6
DIRECTION_D = 6.0
# Log likelihood that two effects must gain over one before they are tried where one suffices.
PAIR_GAIN = 4.0
# Shares of the way to a bound at which scatter beside another effect is looked at.
AMOUNTS = np.array([0.03, 0.1, 0.3, 1.0])
# What a refit of both may gain beyond one effect as it was alone with another beside it.
JOINT_GAIN = 6.0


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
    problem: Problem,
    data: Sample,
    base: Fitted,
    ladders: Sequence[Ladder],
    singles: Sequence[Posterior],
    one_suffices: bool,
    reached: float = -np.inf,
) -> list[tuple[str, str]]:
    """Pairs whose directions together, each in its own sense, fit the baseline's residuals best.

    Those that add up best; where one effect does not suffice, also the likeliest ones with what
    scatters. Log likelihoods with prior below ``reached`` are not worth a fit.
    """
    owners, shifts = directions(base, ladders)
    best = dict(_named(singles))
    likeliest = sorted(best, key=lambda name: -best[name].log_evidence)[:3]
    alone = max(_height(data, each.fitted) for each in singles)
    wanted = max(alone + PAIR_GAIN, reached) if one_suffices else reached
    height: dict[tuple[str, str], float] = {}
    for noise in _noises_to_try(data, best[likeliest[0]].fitted.noise):
        for key, found in _pair_heights(data, base, owners, shifts, noise).items():
            height[key] = max(height.get(key, -np.inf), found)
    for name in likeliest:
        for key, found in _added_heights(data, best[name].fitted, base, owners, shifts).items():
            height[key] = max(height.get(key, -np.inf), found)
    order = [k for k in sorted(height, key=lambda k: (-height[k], k)) if height[k] > wanted]
    order = order[:PAIRS_TRIED]
    if one_suffices:
        return order
    # What scatters is not seen in the mean: with the likeliest single effects it is tried anyway.
    scatter = [x for x in ladders if np.asarray(x.model.weights).size > 1]
    several = sorted(scatter, key=lambda rungs: -best[rungs.name].log_evidence)[:2]
    alike = {rungs.name for rungs in scatter}
    for rungs in several:
        for other in likeliest:
            pair_ = (other, rungs.name)
            if other in alike or pair_ in order or pair_[::-1] in order:
                continue
            if _beside(problem, data, best[other].fitted, rungs)[0] > reached - JOINT_GAIN:
                order.append(pair_)
    return order


def _beside(problem: Problem, data: Sample, alone: Fitted, rungs: Ladder) -> tuple[float, Array]:
    """Log likelihood with prior of a fitted effect with one that scatters beside it, as much of it
    as suits best, and where in the unit box that is; nothing is refitted."""
    model = problem.combine((*alone.effects, rungs.name))
    begin, end = rungs.ends[:, None, 0], rungs.ends[:, None, 1]
    amounts = np.reshape(begin + AMOUNTS[:, None] * (end - begin), (-1, begin.shape[-1]))
    points = np.hstack([np.tile(alone.u, (len(amounts), 1)), amounts])
    predicted = data.predict(model, to_theta(model.parameters, points))
    noises = np.arange(data.noises.scale.size)
    logs = data.heights(data.values[None], predicted, np.asarray(model.weights), noises)
    best = logs.max(axis=1)
    return float(best.max()), points[int(np.argmax(best))]


def _height(data: Sample, fitted: Fitted) -> float:
    """Log likelihood with the noise's prior."""
    return float(fitted.log_likelihood + data.noises.prior[fitted.noise])


def _noises_to_try(data: Sample, noise: int) -> list[int]:
    """This noise, the same without correlation, and the plainest: another effect that is not yet
    in the model may have been taken for either."""
    grid = data.noises
    same = (grid.shape == grid.shape[noise]) & (grid.scale == grid.scale[noise])
    plain = np.flatnonzero((grid.shape == 0) & (grid.correlation == 0))
    return sorted(
        {
            noise,
            int(np.flatnonzero(same & (grid.correlation == 0))[0]),
            int(plain[np.argmin(np.abs(grid.scale[plain] - 1))]),
        }
    )


def _pair_heights(
    data: Sample, base: Fitted, owners: list[str], shifts: Array, noise: int
) -> dict[tuple[str, str], float]:
    """Log likelihood with prior of each pair of effects with the amounts that suit best, one
    Newton step from none, under one noise; pairs in which one is not wanted are left out."""
    grid = data.noises
    one = np.array([noise])
    found = refit(data, (data.values - base.mean)[None], base.mean_slopes, one)
    slopes = grid.filtered(base.mean_slopes.T, base.mean_slopes.T, noise).T
    project = np.eye(slopes.shape[0]) - slopes @ np.linalg.pinv(slopes)
    along = grid.filtered(shifts, shifts, noise) @ project
    shape = int(grid.shape[noise])
    gram = along @ along.T * score_table()[1][shape]
    residual = grid.filtered(found.residual[0], found.residual[0], noise)
    target = along @ influence(residual, shape)
    out: dict[tuple[str, str], float] = {}
    for i in range(len(owners)):
        for j in range(i + 1, len(owners)):
            if owners[i] != owners[j]:
                gain = _two(gram[i, i], gram[j, j], gram[i, j], target[i], target[j])
                key = (owners[i], owners[j])
                if gain > 0:
                    out[key] = max(out.get(key, -np.inf), float(found.height[0]) + gain)
    return out


def _added_heights(
    data: Sample, alone: Fitted, base: Fitted, owners: list[str], shifts: Array
) -> dict[tuple[str, str], float]:
    """Log likelihood with prior of a fitted effect with each other one beside it, as much of that
    as suits best, one Newton step from none; where it is not wanted, left out."""
    grid, noise = data.noises, alone.noise
    spread = np.sqrt(1 + alone.spread**2)
    slopes = grid.filtered((alone.mean_slopes / spread[:, None]).T, alone.mean_slopes.T, noise).T
    project = np.eye(slopes.shape[0]) - slopes @ np.linalg.pinv(slopes)
    along = grid.filtered(shifts / spread, shifts, noise) @ project
    shape = int(grid.shape[noise])
    residual = (data.values - alone.mean) / spread
    target = along @ influence(grid.filtered(residual, residual, noise), shape)
    size = np.sum(along**2, axis=1) * score_table()[1][shape]
    order = list(dict.fromkeys([*owners, *alone.effects]))
    out: dict[tuple[str, str], float] = {}
    for other, load, own in zip(owners, target, size, strict=True):
        if other == alone.effects[0] or load <= 0.0 or own < 1e-6:
            continue
        one, two = sorted((alone.effects[0], other), key=order.index)
        height = _height(data, alone) + 0.5 * float(load**2 / own)
        out[one, two] = max(out.get((one, two), -np.inf), height)
    return out


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
    several: tuple[Sample, Fitted, np.random.Generator],
    names: tuple[str, str],
    singles: Sequence[Posterior],
    ladders: Sequence[Ladder],
) -> Posterior:
    """Refit two effects at once, from what each was alone, halves of it, and a small one; where
    the second one scatters, also from what suits beside the first."""
    data, base, rng = several
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
    if np.asarray(rungs[names[1]].model.weights).size > 1:
        starts.append(_beside(problem, data, alone[names[0]].fitted, rungs[names[1]])[1])
    fitted, shares = settle(data, model, np.array(starts), alone[best].fitted.noise)
    return posterior(data, base, fitted, shares, rng)
