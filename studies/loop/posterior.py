"""How probable is a model, how uncertain its parameters, once all that it could be is summed?

Importance sampling from Student's t at the likeliest point, once adapted, with a tenth of the
points spread over the whole box; noises are summed with their priors. So bounds, skewness and
scatter need no approximation (Owen and Zhou, J. Am. Stat. Assoc. 95 (2000) 135: defensive mixture).

Evidence compares effects on an equal footing. Bounds are wide where little is known, and a prior
spread over them would favour whoever bounded his effect tightly. The prior is one of size:
Cauchy in the whitened, projected effect (Zellner and Siow 1980; Bayarri et al., Ann. Statist. 40
(2012) 1550), the same for all; a direction that the data do not see costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, logsumexp

from ...solver.bristle import Array
from .fit import BOX_PRECISION, Fitted, fit, to_box, to_theta
from .ladder import size
from .noise import Ints
from .sample import Sample

TYPICAL_D = 6.0
DEGREES = 5.0
MOST_NOISES = 16
# Turns of adaptation, until so many points count; and how many a parameter a covariance needs.
TURNS, ENOUGH, FEW = 7, 100.0, 6.0
# Nats by which a point must be likelier than the fit for another fit from there.
RUGGED = 0.1


@dataclass(frozen=True)
class Posterior:
    """Parameters (samples, p) with weights (samples,), the log evidence, and the size ``d``."""

    fitted: Fitted
    theta: Array
    weights: Array
    log_evidence: float
    d: float
    shares: Array
    effective: float

    def interval(self, index: int, level: float = 0.9) -> tuple[float, float]:
        """The central interval of one parameter."""
        order = np.argsort(self.theta[:, index])
        x, w = self.theta[order, index], self.weights[order]
        below = np.cumsum(w) - 0.5 * w
        low, high = np.interp([(1 - level) / 2, (1 + level) / 2], below, x)
        return float(low), float(high)


def posterior(
    data: Sample, base: Fitted, fitted: Fitted, shares: Array, rng: np.random.Generator
) -> Posterior:
    """Sample a fitted model's parameters; ``shares`` are the noises' weights at the fit."""
    weights = np.asarray(fitted.model.weights)
    counts = (128, 384) if weights.size == 1 else (96, 192)
    order = np.argsort(-shares, kind="stable")[:MOST_NOISES]
    noise = np.sort(order[shares[order] > 2e-3])
    fitted, u, ratio = _sampled(data, fitted, noise, counts, rng)
    w = np.exp(ratio - ratio.max())
    integral = float(ratio.max() + np.log(w.mean()))
    w /= w.sum()
    slopes = base.mean_slopes
    shift = fitted.predicted - base.mean
    shift = shift - ((weights @ shift) @ np.linalg.pinv(slopes).T @ slopes.T)
    d = float(size(data, shift[None], weights, np.zeros(data.values.size))[0])
    return Posterior(
        fitted=fitted,
        theta=to_theta(fitted.model.parameters, u),
        weights=w,
        log_evidence=integral + _log_prior(fitted, base.u.size, d),
        d=d,
        shares=shares,
        effective=float(1 / np.sum(w**2)),
    )


def _sampled(
    data: Sample,
    fitted: Fitted,
    noise: Ints,
    counts: tuple[int, int],
    rng: np.random.Generator,
) -> tuple[Fitted, Array, Array]:
    """The fit, or a better one; points (points, p); and their log weights."""
    p = fitted.u.size
    centre = np.asarray(fitted.u)
    cov: Array = np.asarray(np.linalg.inv(fitted.information + BOX_PRECISION * np.eye(p)) * 1.2)
    for turn in range(TURNS):
        count = counts[min(turn, 1)]
        u, proposal = _propose(centre, cov, count, rng)
        inside = np.all((u >= 0) & (u <= 1), axis=1)
        theta = to_theta(fitted.model.parameters, u[inside])
        predicted = data.predict(fitted.model, theta)
        logs = data.noises.prior[noise] + data.log_likelihood(
            data.values[None],
            predicted,
            np.asarray(fitted.model.weights),
            (np.zeros((1, 1), np.int64), np.arange(theta.shape[0])[:, None], noise[None]),
        )
        fitted = _climbed(data, fitted, u[inside], logs, noise)
        ratio: Array = np.full(count, -np.inf)
        ratio[inside] = logsumexp(logs, axis=1) - proposal[inside]
        if turn > 0 and _effective(ratio) > ENOUGH:
            break
        centre, cov = _adapted(u, ratio)
    return fitted, u, ratio


def _climbed(data: Sample, fitted: Fitted, u: Array, logs: Array, noise: Ints) -> Fitted:
    """The fit, or a better one from the best of points (points, p) whose log likelihoods with prior
    are ``logs`` (points, noises): likelihoods summed over few nodes are rugged."""
    if not logs.size:
        return fitted
    best, which = np.unravel_index(int(np.argmax(logs)), logs.shape)
    prior = data.noises.prior
    if logs[best, which] <= fitted.log_likelihood + prior[fitted.noise] + RUGGED:
        return fitted
    found = fit(data, fitted.model, u[best], int(noise[which]))
    better = found.log_likelihood + prior[found.noise]
    return found if better > fitted.log_likelihood + prior[fitted.noise] else fitted


def _effective(ratio: Array) -> float:
    """The effective number of points with these log weights."""
    w = np.exp(ratio - ratio.max())
    return float(w.sum() ** 2 / np.sum(w**2))


def _adapted(u: Array, ratio: Array) -> tuple[Array, Array]:
    """Mean and covariance for the next proposal; weights are flattened until enough points count
    (Cappé et al., Stat. Comput. 18, 2008: adaptive importance sampling)."""
    p = u.shape[1]
    power = 1.0
    while _effective(power * ratio) < FEW * p + 3 and power > 1e-3:
        power *= 0.7
    w = np.exp(power * (ratio - ratio.max()))
    w /= w.sum()
    centre = w @ u
    apart = u - centre
    return centre, (apart * w[:, None]).T @ apart * 1.15 + 1e-12 * np.eye(p)


def _propose(
    centre: Array, cov: Array, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Points (count, p) and their log densities under nine tenths t, one tenth uniform."""
    p = centre.size
    factor = np.linalg.cholesky(cov)
    normal = rng.standard_normal((count, p))
    scale = np.sqrt(rng.chisquare(DEGREES, count) / DEGREES)
    u = centre + (normal / scale[:, None]) @ factor.T
    wide = np.arange(count) % 10 == 9
    u[wide] = rng.random((int(wide.sum()), p))
    z = np.linalg.solve(factor, (u - centre).T)
    student = (
        gammaln((DEGREES + p) / 2)
        - gammaln(DEGREES / 2)
        - 0.5 * p * np.log(DEGREES * np.pi)
        - np.sum(np.log(np.diag(factor)))
        - (DEGREES + p) / 2 * np.log1p(np.sum(z**2, axis=0) / DEGREES)
    )
    share = wide.mean()
    inside = np.all((u >= 0) & (u <= 1), axis=1)
    flat = np.where(inside, np.log(max(share, 1e-300)), -np.inf)
    return u, np.logaddexp(np.log(1 - share) + student, flat)


def _log_prior(fitted: Fitted, own: int, d: float) -> float:
    """Log density of the effect's parameters, in unit-box coordinates, at the fit."""
    h = fitted.information
    if h.shape[0] == own:
        return 0.0
    cross = h[:own, own:]
    profiled = h[own:, own:] - cross.T @ np.linalg.solve(h[:own, :own] + 1e-9 * np.eye(own), cross)
    seen = np.linalg.eigvalsh(profiled)
    seen = seen[seen > BOX_PRECISION]
    q = seen.size
    if q == 0:
        return 0.0
    s = TYPICAL_D
    density = (
        gammaln((1 + q) / 2)
        - gammaln(0.5)
        - q / 2 * np.log(np.pi)
        - q * np.log(s)
        - (1 + q) / 2 * np.log1p((d / s) ** 2)
    )
    one_sided = sum(to_box(each, each.null) in (0.0, 1.0) for each in fitted.model.parameters[own:])
    return float(density + 0.5 * np.sum(np.log(seen)) + min(one_sided, q) * np.log(2.0))
