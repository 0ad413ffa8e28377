"""Would any smooth function of a covariate explain what is left, and how probable is that?

The rival of every listed effect: per quantity a level and polynomial of the covariate's ranks whose
coefficients are normal with variance falling with the square of the degree, a Gaussian process of
low rank, orthogonal to what the baseline's refit absorbs. Its evidence decides, beside the
calibrated tests, whether something is there that no listed effect explains, since a random effect
or a wrong noise may swallow a systematic misfit that it does not explain.

Plumlee, J. Am. Stat. Assoc. 112 (2017) 1274 (orthogonal processes); robust noises enter by one
Newton step from zero: score and Fisher information.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from ...solver.bristle import Array
from .family import Family
from .fit import filtered_slopes
from .noise import Ints, influence, score_table
from .sample import Sample

AMPLITUDES = (2.0, 5.0, 12.0)


def smooth_names(tests: Family) -> tuple[str, ...]:
    """Names of the covariates looked at, in the order of `smooth_heights`' columns."""
    return tuple(n.removeprefix("scatter with ") for n in tests.names if n.startswith("scatter"))


def smooth_heights(
    data: Sample, tests: Family, residual: Array, slopes: Array, among: Ints
) -> Array:
    """Log evidence with prior (sets, covariates, noises) of a smooth misfit in each covariate.

    ``residual`` (sets, rows) after refit along ``slopes`` (rows, p); amplitudes are averaged.
    """
    sets = residual.shape[0]
    out = np.empty((sets, len(tests.bases), among.size))
    plain = plain_heights(data, residual, among)
    project = np.eye(slopes.shape[0]) - slopes @ np.linalg.pinv(slopes)
    for n, noise in enumerate(among):
        e = data.noises.filtered(residual, residual, int(noise))
        shape = int(data.noises.shape[noise])
        psi = influence(e, shape)
        for c, (curves, order) in enumerate(tests.bases):
            shapes = np.concatenate([tests.levels, curves])
            degree = np.concatenate([np.ones(tests.levels.shape[0]), order])
            phi = filtered_slopes(data, project @ shapes.T, int(noise))
            score = psi @ phi
            gram = score_table()[1][shape] * phi.T @ phi
            gains = []
            for amplitude in AMPLITUDES:
                prior = amplitude / degree
                inner = np.eye(degree.size) + prior[:, None] * gram * prior
                lifted = score * prior
                solved = np.linalg.solve(inner, lifted.T).T
                gains.append(
                    0.5 * np.sum(lifted * solved, axis=1) - 0.5 * np.linalg.slogdet(inner)[1]
                )
            out[:, c, n] = plain[:, n] + logsumexp(gains, axis=0) - np.log(len(AMPLITUDES))
    return out


def plain_heights(data: Sample, residual: Array, among: Ints) -> Array:
    """Log likelihood with prior (sets, noises) of residuals with nothing more in them."""
    zero = np.zeros((1, 1, residual.shape[1]))
    return data.noises.prior[among] + data.log_likelihood(
        residual,
        zero,
        np.ones(1),
        (np.arange(residual.shape[0])[:, None], np.zeros((1, 1), np.int64), among[None]),
    )
