"""Maximum likelihood within the parameters' bounds, and its information matrix.

Levenberg-Marquardt on the likelihood that is summed over nodes, many starts at once. Gradient and
curvature are those of the complete data, averaged over the nodes, less what not knowing the node
loses (Louis, J. R. Stat. Soc. B 44 (1982) 226); robust noises enter by their influence and their
weights (IRLS; Huber and Ronchetti, §7). Parameters are scaled to the unit box of their bounds,
logarithmic ones by their logarithm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from ...solver.arrays import Array
from ...solver.effects.base import Parameter
from .noise import LEAST_CURVE, influence, log_density_at, over_nodes, score_table
from .problem import Model
from .sample import Sample

ITERATIONS = 14
# Of differences, in the unit box.
STEP = 1e-4
# A uniform parameter on the unit box has this precision: data that add less do not see it.
BOX_PRECISION = 12.0
# Other maxima count that are less likely by no more nats, and as many deviations away.
MODE_NATS, MODE_APART = 6.0, 4.0
# Nearer to a bound than this, in the unit box, a parameter is on it.
ON_BOUND = 1e-4


def to_theta(parameters: tuple[Parameter, ...], u: Array) -> Array:
    """Parameters (..., p) at points of the unit box (..., p)."""
    out = np.empty_like(u)
    for i, each in enumerate(parameters):
        x = np.clip(u[..., i], 0.0, 1.0)
        if each.logarithmic:
            value = each.low * (each.high / each.low) ** x
        else:
            value = each.low + (each.high - each.low) * x
        out[..., i] = np.clip(value, each.low, each.high)
    return out


def to_unit(parameters: tuple[Parameter, ...], theta: Array) -> Array:
    """Points of the unit box (..., p) of parameters (..., p); beyond the bounds, on the nearer."""
    theta = np.asarray(theta, dtype=float)
    out = np.empty_like(theta)
    for i, each in enumerate(parameters):
        value = np.clip(theta[..., i], each.low, each.high)
        if each.logarithmic:
            out[..., i] = np.log(value / each.low) / np.log(each.high / each.low)
        else:
            out[..., i] = (value - each.low) / (each.high - each.low)
    return out


def to_box(parameter: Parameter, value: float) -> float:
    """Where in [0, 1] one parameter's value lies."""
    return float(to_unit((parameter,), np.array([value]))[0])


@dataclass(frozen=True)
class Fitted:
    """A model at its likeliest parameters under one noise.

    ``u``, ``theta`` (p,); ``information`` (p, p) by unit-box coordinates; ``predicted`` (nodes,
    rows of the sample), ``slopes`` (nodes, rows, p); ``unseen`` names the parameters in directions
    that the data do not see; ``modes`` (n, p), in the unit box, are other maxima, nearly as likely.
    ``logs`` (noises,) are the log likelihoods of these predictions with prior, under every noise.
    """

    model: Model
    u: Array
    theta: Array
    log_likelihood: float
    noise: int
    information: Array
    predicted: Array
    slopes: Array
    unseen: tuple[str, ...]
    logs: Array
    modes: tuple[Array, ...] = ()

    @property
    def likeliest(self) -> int:
        """The likeliest noise at these predictions."""
        return int(np.argmax(self.logs))

    @property
    def height(self) -> float:
        """Its log likelihood with prior."""
        return float(self.logs.max())

    @property
    def shares(self) -> Array:
        """How probable each noise is (noises,)."""
        return np.asarray(softmax(self.logs))

    @property
    def effects(self) -> tuple[str, ...]:
        return self.model.effects

    @property
    def loose(self) -> NDArray[np.bool_]:
        """Which parameters (p,) are not on a bound: what a refit can move both ways."""
        return np.asarray((self.u > ON_BOUND) & (self.u < 1 - ON_BOUND))

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Parameters on a bound that is not their absence."""
        return tuple(
            each.name
            for each, u, free in zip(self.model.parameters, self.u, self.loose, strict=True)
            if not free and abs(u - to_box(each, each.null)) > ON_BOUND
        )

    @property
    def mean(self) -> Array:
        """Predicted mean over nodes (rows,)."""
        return np.asarray(self.model.weights @ self.predicted)

    @property
    def spread(self) -> Array:
        """Standard deviation of one row over nodes (rows,), without noise."""
        return np.sqrt(self.model.weights @ (self.predicted - self.mean) ** 2)

    @property
    def mean_slopes(self) -> Array:
        """Slopes of the mean (rows, p)."""
        return np.einsum("j,jrp->rp", self.model.weights, self.slopes)


@runtime_checkable
class Chosen(Model, Protocol):
    """A model that was chosen by the data among several, which counts against it."""

    @property
    def choices(self) -> int:
        """Among how many."""
        ...

    @property
    def remarks(self) -> Mapping[str, str]:
        """By effect what its parameters do not tell, such as where it acts."""
        ...

    def chosen(self, data: Sample, beside: Fitted) -> Model:
        """The same, as these data choose it beside a fit of all its other effects."""
        ...


def differences(
    predict: Callable[[Array], Array], u: Array, step: Array, here: Array | None = None
) -> tuple[Array, Array]:
    """What ``predict`` makes of points ``u`` (n, p) of the unit box, (n, ...), and its slopes
    (n, p, ...) in the first coordinates, by differences of ``step`` (n, up to p), which point
    inward at a bound.

    ``predict`` takes points (..., p). What it makes of ``u`` may be known: ``here``.
    """
    count = step.shape[1]
    signed = np.where(u[:, :count] + step > 1.0, -step, step)
    points = np.repeat(u[:, None, :], count + 1, axis=1)
    moved = np.arange(count)
    points[:, moved + 1, moved] += signed
    every = predict(points if here is None else points[:, 1:])
    if here is None:
        here, every = every[:, 0].copy(), every[:, 1:]
    return here, (every - here[:, None]) / signed.reshape(*signed.shape, *(1,) * (every.ndim - 2))


def differentiate(
    data: Sample, model: Model, u: Array, step: Array, here: Array | None = None
) -> tuple[Array, Array]:
    """Predictions (starts, nodes, rows) and slopes (starts, nodes, rows, p) by `differences`."""
    base, slopes = differences(
        lambda points: data.predict(model, to_theta(model.parameters, points)), u, step, here
    )
    return base, np.moveaxis(slopes, 1, -1)


def _newton(
    data: Sample, model: Model, values: Array, base: Array, slopes: Array, noise: int
) -> tuple[Array, Array]:
    """Gradient (starts, p) and curvature (starts, p, p) of minus the log likelihood."""
    grid, weights = data.noises, np.asarray(model.weights)
    residual = values - base
    centre = np.einsum("j,sjr->sr", weights, residual)
    e = grid.filtered(residual, centre[:, None, :], noise)
    each = np.moveaxis(slopes, -1, 0)
    mean = np.einsum("j,psjr->psr", weights, each)[:, :, None]
    tangent = grid.filtered(each, mean, noise)
    shape = int(grid.shape[noise])
    if weights.size == 1:
        e, t = e[:, 0], tangent[:, :, 0]
        psi = influence(e, shape)
        curve = np.where(np.abs(e) > 1e-6, psi / np.where(e == 0, 1.0, e), 1.0)
        curve = np.maximum(curve, LEAST_CURVE)
        gradient = -np.einsum("sr,psr->sp", psi, t)
        return gradient, np.einsum("sr,psr,qsr->spq", curve, t, t, optimize=True)
    share = node_shares(data, e, weights, shape)
    score, exact = over_nodes(
        e, np.ascontiguousarray(tangent), share, data.starts, score_table()[0][shape]
    )
    outer = np.einsum("sgp,sgq->spq", score, score)
    exact += outer
    # Far from the optimum the exact curvature need not be positive; the scores' own always is.
    bad = np.linalg.eigvalsh(exact)[:, 0] <= 1e-3 * np.trace(exact, axis1=1, axis2=2)
    return -score.sum(axis=1), np.where(bad[:, None, None], outer, exact)


def node_shares(data: Sample, e: Array, weights: Array, shape: int) -> Array:
    """Probability (starts, nodes, groups) of each node, from filtered residuals of each."""
    logs = (
        np.add.reduceat(log_density_at(e, shape), data.starts[:-1], axis=-1)
        + np.log(weights)[:, None]
    )
    return np.asarray(softmax(logs, axis=-2))


def fit(
    data: Sample, model: Model, starts: Array, noise: int, iterations: int = ITERATIONS
) -> Fitted:
    """The likeliest parameters from several starts (starts, p) in the unit box, noise given."""
    u: Array = np.clip(np.atleast_2d(np.asarray(starts, dtype=float)), 0.0, 1.0)
    count, p = u.shape
    weights = np.asarray(model.weights)
    case = np.arange(count)
    zero = np.zeros(count, dtype=np.int64)
    values = data.values[None, :]

    def likelihood(base: Array) -> Array:
        return data.log_likelihood(values, base, weights, (zero, case, zero + noise))

    base, slopes = differentiate(data, model, u, np.full((count, p), STEP))
    height = likelihood(base)
    damping = np.asarray(np.full(count, 1e-2))
    gradient, curve = np.empty((count, p)), np.empty((count, p, p))
    better: NDArray[np.bool_] = np.full(count, True)
    for _ in range(iterations):
        if better.any():
            gradient[better], curve[better] = _newton(
                data, model, values[:, None, :], base[better], slopes[better], noise
            )
        move = _bounded_step(u, gradient, curve, damping)
        trial = np.clip(u + move, 0.0, 1.0)
        if np.all(np.abs(trial - u) < 1e-9):
            break
        there = data.predict(model, to_theta(model.parameters, trial))
        found = likelihood(there)
        better = found >= height
        gain = np.where(better, found - height, 0.0)
        if better.any():
            size = np.sqrt(np.maximum(np.einsum("spp->sp", curve[better]), 1e-30))
            u, step = np.where(better[:, None], trial, u), np.clip(0.05 / size, 1e-7, 1e-3)
            base[better], slopes[better] = differentiate(
                data, model, u[better], step, there[better]
            )
        height = np.where(better, found, height)
        done = better & (gain < 1e-5)
        damping = np.where(better, damping / 8, np.minimum(damping * 8, 1e8))
        if np.all(done | (damping > 1e5)):
            break
    best = int(np.argmax(height))
    end = float(height[best])
    likeliest = _finish(data, model, u[best], base[best], slopes[best], end, noise)
    return replace(likeliest, modes=tuple(u[i] for i in others(likeliest, u, height)))


def others(found: Fitted, u: Array, height: Array) -> list[int]:
    """Numbers of the points (n, p), of log likelihoods ``height``, that may be other maxima."""
    chosen: list[int] = []
    for i in np.argsort(-height, kind="stable"):
        if height[i] < found.log_likelihood - MODE_NATS:
            break
        away = [u[i] - each for each in (found.u, *u[chosen])]
        if all(d @ found.information @ d > MODE_APART**2 for d in away):
            chosen.append(int(i))
    return chosen


def _bounded_step(u: Array, gradient: Array, curve: Array, damping: Array) -> Array:
    """A damped Newton step in which parameters that push against their bound stay."""
    p = u.shape[1]
    stuck = ((u <= 0) & (gradient > 0)) | ((u >= 1) & (gradient < 0))
    scale = np.maximum(np.einsum("spp->sp", curve), 1e-8)
    matrix = curve + (damping[:, None] * scale)[:, :, None] * np.eye(p) + 1e-6 * np.eye(p)
    open_ = ~stuck
    matrix = np.where(open_[:, :, None] & open_[:, None, :], matrix, np.eye(p)[None])
    return -np.linalg.solve(matrix, np.where(open_, gradient, 0.0)[..., None])[..., 0]


def _finish(
    data: Sample, model: Model, u: Array, base: Array, slopes: Array, height: float, noise: int
) -> Fitted:
    if np.asarray(model.weights).size == 1:
        information = expected_information(data, slopes[0], noise)
    else:
        values = data.values[None, None, :]
        information = _newton(data, model, values, base[None], slopes[None], noise)[1][0]
    names = [each.name for each in model.parameters]
    values, vectors = np.linalg.eigh(information)
    unseen = {
        names[i]
        for k in range(len(names))
        if values[k] < BOX_PRECISION
        for i in np.flatnonzero(np.abs(vectors[:, k]) > 0.3)
    }
    return Fitted(
        model=model,
        u=u,
        theta=to_theta(model.parameters, u),
        log_likelihood=height,
        noise=noise,
        information=information,
        predicted=base,
        slopes=slopes,
        unseen=tuple(name for name in names if name in unseen),
        logs=data.heights(data.values[None], base[None], np.asarray(model.weights))[0],
    )


def expected_information(data: Sample, slopes: Array, noise: int) -> Array:
    """Fisher information (p, p) of slopes (rows, p) under a noise, which sees them freed of the
    previous row, in core scales."""
    tangent = data.noises.filtered(slopes.T, slopes.T, noise).T
    return score_table()[1][data.noises.shape[noise]] * tangent.T @ tangent


def settle(data: Sample, model: Model, starts: Array) -> Fitted:
    """Fit as if the noise were normal, then choose the likeliest noise and fit again.

    Under a normal noise the likelihood has no plateaus far from the data, where a robust one is
    lost; outliers are seen to afterwards.
    """
    fitted = fit(data, model, starts, 0)
    modes = fitted.modes
    robust = fit(data, model, fitted.u, data.noises.robust())
    if robust.height > fitted.height:
        fitted = robust
    for _ in range(2):
        if fitted.likeliest == fitted.noise:
            break
        fitted = fit(data, model, fitted.u, fitted.likeliest, iterations=8)
    return replace(fitted, modes=modes)
