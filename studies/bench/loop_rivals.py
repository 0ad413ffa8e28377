"""What would simpler methods say of the same data?"""

from __future__ import annotations

import warnings

import numpy as np
from scipy import stats

from ...solver.bristle import Array
from ..loop.fit import Fitted, fit, to_box
from ..loop.heldout import split
from ..loop.problem import Model, Problem
from ..loop.sample import Sample, sample

GAUSSIAN = 0
LEVEL = 0.05


def rivals(problem: Problem, seed: int) -> dict[str, str]:
    """What each says: `adequate`, `unknown`, or the name of an effect."""
    groups, _ = split(problem, seed)
    data = sample(problem, groups)
    base = fit(data, problem.baseline, _starts(problem.baseline, None), GAUSSIAN)
    fitted = [fit(data, model, _starts(model, base), GAUSSIAN) for model in problem.candidates]
    residual = data.values - base.mean
    return {
        "BIC": _bic(data, base, fitted),
        "lasso": _lasso(data, base, fitted, residual, seed),
        "Gaussian process": _process(data, residual, seed),
        "chi-square": _chi_square(residual, base.u.size),
    }


def _starts(model: Model, base: Fitted | None) -> Array:
    parameters = model.parameters
    usual = np.array([to_box(p, p.typical) for p in parameters])
    if base is None:
        return np.stack(
            [usual, *(np.where(np.arange(len(usual)) >= 0, s, usual) for s in (0.2, 0.8))]
        )
    rows = []
    own = base.u.size
    for share in (0.02, 0.2):
        for end in (0.0, 1.0):
            row = usual.copy()
            row[:own] = base.u
            for i in range(own, len(row)):
                null = to_box(parameters[i], parameters[i].null)
                row[i] = null + share * (end - null)
            rows.append(row)
    return np.array(rows)


def _bic(data: Sample, base: Fitted, fitted: list[Fitted]) -> str:
    """The smallest Bayesian information criterion (Schwarz, Ann. Stat. 6, 1978)."""
    n = np.log(len(data.values))
    scores = [(-2.0 * each.log_likelihood + n * each.u.size, each) for each in (base, *fitted)]
    best = min(scores, key=lambda pair: pair[0])[1]
    return best.effects[0] if best.effects else "adequate"


def _lasso(data: Sample, base: Fitted, fitted: list[Fitted], residual: Array, seed: int) -> str:
    """The largest coefficient of a cross-validated lasso on the effects' directions."""
    from sklearn.linear_model import LassoCV

    slopes = base.mean_slopes
    project = np.eye(len(residual)) - slopes @ np.linalg.pinv(slopes)
    columns, names = [], []
    for each in fitted:
        direction = project @ (each.mean - base.mean)
        size = np.linalg.norm(direction)
        if size > 1e-6:
            columns.append(direction / size)
            names.append(each.effects[0])
    if not columns:
        return "adequate"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folds = np.random.default_rng(seed).permutation(len(residual)) % 5
        splits = [(np.flatnonzero(folds != k), np.flatnonzero(folds == k)) for k in range(5)]
        found = LassoCV(cv=splits, fit_intercept=False, n_alphas=50).fit(
            np.array(columns).T, project @ residual
        )
    largest = int(np.argmax(np.abs(found.coef_)))
    return names[largest] if abs(found.coef_[largest]) > 0.0 else "adequate"


def _process(data: Sample, residual: Array, seed: int) -> str:
    """A Gaussian process over all covariates against white noise, by their likelihoods."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    columns = [x for x in data.covariates.values() if np.ptp(x) > 0.0]
    where = np.array([(x - x.min()) / np.ptp(x) for x in columns] + [data.kind]).T
    kernel = ConstantKernel(0.5, (1e-3, 1e2)) * RBF(np.full(where.shape[1], 0.5), (0.05, 20.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        process = GaussianProcessRegressor(kernel + WhiteKernel(1.0, (0.2, 5.0)), random_state=seed)
        process.fit(where, residual)
    plain = stats.norm.logpdf(residual, scale=np.sqrt(np.mean(residual**2))).sum()
    gain = 2.0 * (process.log_marginal_likelihood_value_ - plain)
    return "unknown" if gain > stats.chi2.ppf(1.0 - LEVEL, where.shape[1] + 1) else "adequate"


def _chi_square(residual: Array, parameters: int) -> str:
    """The residuals' sum of squares against its distribution, no more."""
    p = stats.chi2.sf(float(residual @ residual), len(residual) - parameters)
    return "unknown" if p < LEVEL else "adequate"
