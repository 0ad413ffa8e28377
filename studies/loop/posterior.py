"""Posterior of a model's parameters by adaptive importance sampling, and its evidence.

Proposals are Student's t about every maximum, adapted where it is one until enough points count,
with a tenth of them spread over the whole box; noises are summed with their priors. So bounds,
skewness and scatter need no approximation (Owen and Zhou, J. Am. Stat. Assoc. 95 (2000) 135:
defensive mixture).

Evidence compares effects on an equal footing: the greatest likelihood less `OCCAM` for each of the
effect's parameters that the data see. A prior over an effect's bounds would favour whoever bounded
his effect tightly (unit information: Kass and Wasserman, J. Am. Stat. Assoc. 90 (1995) 928).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, logsumexp, softmax

from ...solver.arrays import Array
from .adequacy import OCCAM
from .fit import BOX_PRECISION, Chosen, Fitted, fit, others, to_theta
from .noise import Ints, Noises
from .sample import Sample

DEGREES = 5.0
MOST_NOISES = 16
# The first proposal's covariance over that of the fit, whose curvature a kink may make too large.
WIDER = 2.5
# Turns of adaptation, until so many points count; and how many a parameter a covariance needs.
TURNS, ENOUGH, FEW = 7, 100.0, 6.0
# With fewer an end of a 90 % interval is a matter of chance.
LEAST_POINTS = 30.0
# Nats by which a point must be likelier than the fit for another fit from there.
RUGGED = 0.1


@dataclass(frozen=True)
class Posterior:
    """Parameters (samples, p) with weights (samples,), and the log evidence of the model."""

    fitted: Fitted
    theta: Array
    weights: Array
    log_evidence: float
    noises: Noises

    @property
    def effects(self) -> tuple[str, ...]:
        return self.fitted.effects

    def interval(self, index: int, level: float = 0.9) -> tuple[float, float]:
        """The central interval of one parameter."""
        order = np.argsort(self.theta[:, index])
        x, w = self.theta[order, index], self.weights[order]
        below = np.cumsum(w) - 0.5 * w
        low, high = np.interp([(1 - level) / 2, (1 + level) / 2], below, x)
        return float(low), float(high)

    @property
    def few(self) -> bool:
        """Whether so few points count that intervals are rough."""
        return 1.0 / float(np.sum(self.weights**2)) < LEAST_POINTS

    def median(self, index: int) -> float:
        """The posterior median of one parameter, which no interval leaves out."""
        return self.interval(index, 0.0)[0]


def evidence(fitted: Fitted, own: int) -> float:
    """Log evidence of a fit whose first ``own`` parameters are the baseline's."""
    count, model = 0, fitted.model
    if fitted.u.size > own:
        h = fitted.information
        cross = h[:own, own:]
        inner = h[:own, :own] + 1e-9 * np.eye(own)
        profiled = h[own:, own:] - cross.T @ np.linalg.solve(inner, cross)
        count = max(int(np.sum(np.linalg.eigvalsh(profiled) > BOX_PRECISION)), 1)
    chosen = math.log(model.choices) if isinstance(model, Chosen) else 0.0
    return fitted.height - OCCAM * count - chosen


def posterior(data: Sample, fitted: Fitted, own: int, rng: np.random.Generator) -> Posterior:
    """Sample a fitted model's parameters; the first ``own`` are the baseline's."""
    shares = fitted.shares
    counts = (128, 384) if np.asarray(fitted.model.weights).size == 1 else (96, 192)
    order = np.argsort(-shares, kind="stable")[:MOST_NOISES]
    noise = np.sort(order[shares[order] > 2e-3])
    fitted, u, ratio = _sampled(data, fitted, noise, counts, rng)
    return Posterior(
        fitted=fitted,
        theta=to_theta(fitted.model.parameters, u),
        weights=np.asarray(softmax(ratio)),
        log_evidence=evidence(fitted, own),
        noises=data.noises,
    )


def _sampled(
    data: Sample,
    fitted: Fitted,
    noise: Ints,
    counts: tuple[int, int],
    rng: np.random.Generator,
) -> tuple[Fitted, Array, Array]:
    """The fit, or a better one; points (points, p); and their log weights.

    Points of all turns count, each under the mixture of all proposals, so a proposal that has
    shrunk to the wrong place cannot pass for the whole (Cornuet et al., Scand. J. Stat. 39, 2012).
    """
    ways = [_about(each) for each in _maxima(data, fitted)]
    proposals: list[Proposal] = []
    points: list[Array] = []
    targets: list[Array] = []
    for turn in range(TURNS):
        count = counts[min(turn, 1)]
        now = [Proposal(centre, np.linalg.cholesky(cov), count) for centre, cov in ways]
        proposals += now
        u = np.concatenate([each.draw(rng) for each in now])
        inside = np.all((u >= 0) & (u <= 1), axis=1)
        theta = to_theta(fitted.model.parameters, u[inside])
        logs = data.heights_at(fitted.model, theta, noise)
        before, fitted = fitted, _climbed(data, fitted, u[inside], logs, noise)
        target = np.full(len(u), -np.inf)
        target[inside] = logsumexp(logs, axis=1)
        points.append(u)
        targets.append(target)
        every = np.concatenate(points)
        parts = np.array([each.count for each in proposals]) / len(every)
        densities = np.array([each.log_density(every) for each in proposals])
        ratio = np.concatenate(targets) - logsumexp(densities, b=parts[:, None], axis=0)
        if turn > 0 and _effective(ratio) > ENOUGH:
            break
        if fitted is not before:
            ways = [_about(fitted)]
        elif len(ways) == 1 or turn:
            ways = [_adapted(every, ratio)]
    return fitted, every, np.asarray(ratio)


def _maxima(data: Sample, fitted: Fitted) -> list[Fitted]:
    """The fit, and those of its other modes that are maxima under its noise too."""
    again = [fit(data, fitted.model, u, fitted.noise) for u in fitted.modes]
    heights = np.array([each.log_likelihood for each in again])
    return [fitted, *(again[i] for i in others(fitted, np.array([e.u for e in again]), heights))]


def _about(fitted: Fitted) -> tuple[Array, Array]:
    """Centre and covariance of a proposal about a fit."""
    precision = fitted.information + BOX_PRECISION * np.eye(fitted.u.size)
    return np.asarray(fitted.u), np.asarray(np.linalg.inv(precision) * WIDER)


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
    return float(1.0 / np.sum(softmax(ratio) ** 2))


def _adapted(u: Array, ratio: Array) -> tuple[Array, Array]:
    """Mean and covariance for the next proposal; weights are flattened until enough points count
    (Cappé et al., Stat. Comput. 18, 2008: adaptive importance sampling)."""
    p = u.shape[1]
    power = 1.0
    while _effective(power * ratio) < FEW * p + 3 and power > 1e-3:
        power *= 0.7
    w = np.asarray(softmax(power * ratio))
    centre = w @ u
    apart = u - centre
    return centre, (apart * w[:, None]).T @ apart * 1.15 + 1e-12 * np.eye(p)


@dataclass(frozen=True)
class Proposal:
    """Nine tenths Student's t about ``centre`` (p,) with the ``factor`` (p, p) of its scale, one
    tenth uniform in the unit box; ``count`` points."""

    centre: Array
    factor: Array
    count: int

    def draw(self, rng: np.random.Generator) -> Array:
        """The points (count, p)."""
        p = self.centre.size
        normal = rng.standard_normal((self.count, p))
        scale = np.sqrt(rng.chisquare(DEGREES, self.count) / DEGREES)
        u = self.centre + (normal / scale[:, None]) @ self.factor.T
        wide = np.arange(self.count) % 10 == 9
        u[wide] = rng.random((int(wide.sum()), p))
        return np.asarray(u)

    def log_density(self, u: Array) -> Array:
        """At points (points, p)."""
        p = self.centre.size
        z = np.linalg.solve(self.factor, (u - self.centre).T)
        student = (
            gammaln((DEGREES + p) / 2)
            - gammaln(DEGREES / 2)
            - 0.5 * p * np.log(DEGREES * np.pi)
            - np.sum(np.log(np.diag(self.factor)))
            - (DEGREES + p) / 2 * np.log1p(np.sum(z**2, axis=0) / DEGREES)
        )
        inside = np.all((u >= 0) & (u <= 1), axis=1)
        wide = (self.count // 10) / self.count
        flat = np.where(inside, np.log(wide), -np.inf)
        return np.logaddexp(np.log(1 - wide) + student, flat)
