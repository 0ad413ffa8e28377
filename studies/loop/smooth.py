"""Would something that no list has explain what is left, and how probable is that?

The rivals of every listed effect. Each is a Gaussian process orthogonal to what the baseline's
refit absorbs: a smooth function of a covariate, per quantity a level and polynomial of its levels
with variance falling with the square of the degree, or one degree alone; in the order of the drops
a step and an alternation, each alike at all heights or in proportion to the height; and independent
scatter beyond the declared sigma. Each may be in all quantities or in one. Their evidence decides,
beside the calibrated tests, whether something is there that no listed effect explains, since a
random effect, a wrong noise or a pair of effects may swallow a misfit that it does not explain.

Plumlee, J. Am. Stat. Assoc. 112 (2017) 1274 (orthogonal processes); robust noises enter by one
Newton step from zero: score and Fisher information. Steps: Chernoff and Zacks, Ann. Math. Statist.
35 (1964) 999, amplitudes normal, the place of the change uniform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from ...solver.bristle import Array
from .family import Family
from .fit import filtered_slopes
from .noise import Ints, influence, score_table
from .sample import BETWEEN, HEIGHT, Sample

AMPLITUDES = (2.0, 5.0, 12.0)
# Standard deviations of scatter beyond the declared one: it grows to 1.2 and up to 4 times.
SCATTERS = (0.7, 1.2, 2.0, 4.0)
MOST_STEPS = 20
# A step needs this share of the drops on either side.
EDGE = 0.1


@dataclass(frozen=True)
class Rival:
    """One way of being unlisted: directions ``shapes`` (alternatives, k, rows) with the standard
    deviations of their amounts, ``priors`` (choices, k); all alternatives and choices are alike."""

    name: str
    shapes: Array
    priors: Array


def rivals(data: Sample, tests: Family) -> tuple[Rival, ...]:
    """All rivals but scatter, for these rows."""
    out = []
    own = np.array([int(data.kind[np.argmax(level != 0)]) for level in tests.levels])
    covariates = [n.removeprefix("scatter with ") for n in tests.names if n.startswith("scatter w")]
    for name, (curves, order) in zip(covariates, tests.bases, strict=True):
        kinds = np.concatenate([own, [int(data.kind[np.argmax(c != 0)]) for c in curves]])
        degree = np.concatenate([np.zeros(own.size), order])
        priors = [_choices(kinds) / np.maximum(degree, 1.0)]
        priors += [_choices(kinds) * (degree == each) for each in np.unique(order)]
        shapes = np.concatenate([tests.levels, curves])[None]
        out.append(Rival(f"any function of {name}", shapes, _distinct(np.concatenate(priors))))
    order_ = next((data.covariates[n] for n in BETWEEN if n in data.covariates), None)
    if order_ is None:
        return tuple(out)
    height = next((data.covariates[n] for n in HEIGHT if n in data.covariates), None)
    factors = [np.ones(order_.size)] + ([] if height is None else [height])
    made = np.unique(order_)
    after = [(order_ >= x).astype(float) for x in _changes(made)]
    # The model may hold before the change or after it.
    step = [*after, *(1.0 - side for side in after)]
    turn = [np.where(np.round(order_) % 2 == 0, 1.0, -1.0)] if made.size >= 8 else []
    for name, sides in (("a step in order", step), ("alternation in order", turn)):
        found = [_sided(data.kind, side, factor) for side in sides for factor in factors]
        if found:
            out.append(Rival(name, np.array(found), _choices(np.unique(data.kind))))
    return tuple(out)


def _choices(kinds: Ints) -> Array:
    """Standard deviations (choices, k) of directions of these quantities: all, or one alone."""
    each = np.unique(kinds)
    masks = [np.ones(kinds.size)]
    if each.size > 1:
        masks += [(kinds == k).astype(float) for k in each]
    return np.array([a * mask for mask in masks for a in AMPLITUDES])


def _distinct(priors: Array) -> Array:
    """Each choice (choices, k) once, and none in which nothing is there."""
    return np.unique(priors[np.any(priors > 0, axis=1)], axis=0)


def _changes(made: Array) -> Array:
    """Where in the order a step may be, evenly thinned to `MOST_STEPS`."""
    edge = max(2, round(EDGE * made.size))
    inner = made[edge : made.size - edge + 1]
    if inner.size == 0:
        return inner
    return inner[np.unique(np.linspace(0, inner.size - 1, min(inner.size, MOST_STEPS)).astype(int))]


def _sided(kind: Ints, side: Array, factor: Array) -> Array:
    """Unit directions (quantities, rows) of what differs between sides, each quantity's own."""
    out = np.where(kind == np.unique(kind)[:, None], side * factor, 0.0)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)


def rival_names(data: Sample, tests: Family) -> tuple[str, ...]:
    """Names of the rivals, in the order of `rival_heights`' columns."""
    names = [each.name for each in rivals(data, tests)]
    return (*names, "scatter beyond sigma") if data.noises.declared else tuple(names)


def rival_heights(
    data: Sample, tests: Family, residual: Array, slopes: Array, among: Ints
) -> Array:
    """Log evidence with prior (sets, rivals, noises) of every rival.

    ``residual`` (sets, rows), or (noises, sets, rows) where each noise has its own, after refit
    along ``slopes`` (rows, p); amplitudes, places and quantities are averaged.
    """
    own = residual.ndim == 3
    absorbed = np.linalg.pinv(slopes)
    every = []
    for rival in rivals(data, tests):
        flat = rival.shapes.reshape(-1, rival.shapes.shape[-1])
        every.append((rival, flat - (flat @ absorbed.T) @ slopes.T))
    kinds = np.unique(data.kind)
    columns = []
    for n, noise in enumerate(among):
        left = residual[n] if own else residual
        shape = int(data.noises.shape[noise])
        psi = influence(data.noises.filtered(left, left, int(noise)), shape)
        information = float(score_table()[1][shape])
        gains = [
            _gain(psi, rival, filtered_slopes(data, flat.T, int(noise)), information)
            for rival, flat in every
        ]
        if data.noises.declared:
            power = np.stack([np.sum(psi[:, data.kind == k] ** 2, axis=1) for k in kinds], axis=1)
            counts = np.array([np.sum(data.kind == k) for k in kinds])
            gains.append(_scatter(power, counts, information))
        plain = plain_heights(data, left, among[n : n + 1])
        columns.append(plain + np.stack(gains, axis=1).reshape(left.shape[0], len(gains)))
    return np.stack(columns, axis=2)


def _gain(psi: Array, rival: Rival, phi: Array, information: float) -> Array:
    """Log evidence (sets,) that a rival gains; ``phi`` (rows, alternatives * k) as noise sees."""
    many, k = rival.shapes.shape[:2]
    split = phi.T.reshape(many, k, -1)
    gram = information * split @ np.swapaxes(split, 1, 2)
    score = (psi @ phi).reshape(-1, many, k)
    gains = []
    for prior in rival.priors:
        there = np.flatnonzero(prior)
        some = prior[there]
        inner = np.eye(there.size) + some[:, None] * gram[:, there[:, None], there] * some
        lifted = score[:, :, there] * some
        solved = np.einsum("aij,saj->sai", np.linalg.inv(inner), lifted)
        gains.append(0.5 * np.sum(lifted * solved, axis=2) - 0.5 * np.linalg.slogdet(inner)[1])
    found = np.concatenate(gains, axis=1)
    return np.asarray(logsumexp(found, axis=1) - np.log(found.shape[1]))


def _scatter(power: Array, counts: Array, information: float) -> Array:
    """Log evidence (sets,) that independent normal scatter gains, in all quantities or in one.

    ``power`` (sets, quantities) are sums of squared scores, ``counts`` (quantities,) of rows.
    """
    square = np.square(SCATTERS)
    inside = 1 + square * information
    each = 0.5 * (power[..., None] * square / inside - counts[:, None] * np.log(inside))
    options = [each.sum(axis=1)]
    if counts.size > 1:
        options += [each[:, k] for k in range(counts.size)]
    found = np.concatenate(options, axis=1)
    return np.asarray(logsumexp(found, axis=1) - np.log(found.shape[1]))


def plain_heights(data: Sample, residual: Array, among: Ints) -> Array:
    """Log likelihood with prior (sets, noises) of residuals with nothing more in them."""
    return data.heights(residual, np.zeros((1, 1, residual.shape[1])), np.ones(1), among)
