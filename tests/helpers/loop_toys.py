"""Small problems with a known truth: drops at five heights, fifteen effects, one baseline."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from dataclasses import field as dc_field

import numpy as np
from scipy.optimize import brentq

from bristle.solver.effects.base import Parameter
from bristle.solver.errors import ComputationError
from bristle.studies.loop.problem import Experiment, Problem

HEIGHTS = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
Field = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Design:
    """Drops: height (rows,), order (rows,), quantity (rows,), group (rows,)."""

    height: np.ndarray
    order: np.ndarray
    quantity: np.ndarray
    group: np.ndarray

    @property
    def x(self) -> np.ndarray:
        return (self.height - 30.0) / 20.0

    @property
    def t(self) -> np.ndarray:
        return 2 * self.order / self.order.max() - 1


def design(rng: np.random.Generator, drops: int = 48, quantities: int = 2) -> Design:
    """Heights in a random order, each drop measured in one to three quantities."""
    height = rng.permutation(np.resize(HEIGHTS, drops))
    return Design(
        np.repeat(height, quantities),
        np.repeat(np.arange(drops), quantities),
        np.tile(np.arange(quantities), drops),
        np.repeat(np.arange(drops), quantities),
    )


def _by(quantity: np.ndarray, *columns: np.ndarray) -> np.ndarray:
    """Rows by quantity: rebound, contact time, peak force."""
    return np.choose(quantity, [np.broadcast_to(c, quantity.shape) for c in columns])


def fields(d: Design) -> dict[str, np.ndarray]:
    """Unit responses (rows,) of the toy's deterministic effects; some are alike."""
    h, x, t, q = d.height / 30.0, d.x, d.t, d.quantity
    one = np.ones_like(x)
    return {
        "drag": _by(q, -(h**2), 0 * x, 0 * x),
        "offset": _by(q, one / h, 0 * x, 0 * x),
        "scale": _by(q, h, 0 * x, 0 * x),
        "clock": _by(q, 0 * x, one, 0 * x),
        "dashpot": _by(q, -h, 0.3 * one, 0.5 * h),
        "crossley": _by(q, -(h**1.5), 0.25 * h**0.5, 0.4 * h),
        "stiffening": _by(q, 0.1 * x, -(h**-0.2) + 0.2 * x, h**1.2),
        "plastic": _by(q, -np.sqrt(np.maximum(h - 0.5, 0)), 0.5 * x, -(h**0.5)),
        "adhesion": _by(q, -1 / h, 0.5 / h, 0 * x),
        "rayleigh": _by(q, -1.02 * h, 0.29 * one, 0.49 * h),
        "hysteretic": _by(q, -h, 0 * x, 0.8 * h),
        "wear": _by(q, t, -0.3 * t, 0.2 * t),
        "release": _by(q, h**0.5, 0.1 * x, 0.4 * h**0.5),
    }


SCALED = {"slope": (1.0, 0.2, 0.5), "phases": (0.3, 1.0, -0.6)}


@dataclass(frozen=True)
class Toy:
    """A model whose mean adds up fields times amounts; saturating where ``curved``."""

    effects: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    weights: np.ndarray
    base: np.ndarray
    parts: tuple[tuple[np.ndarray, bool], ...]
    chance: tuple[np.ndarray, np.ndarray] | None = None

    def predict(self, theta: np.ndarray) -> np.ndarray:
        theta = np.asarray(theta, dtype=float)
        # Logarithmic stiffness moves everything, a little bent.
        s = np.log(theta[..., 0:1])
        mean = s * self.base + 0.02 * s**2 * self.base
        for i, (field, curved) in enumerate(self.parts):
            a = theta[..., 1 + i : 2 + i]
            mean = mean + (20 * np.tanh(a / 20) if curved else a) * field
        if self.chance is None:
            return mean[..., None, :]
        nodes, field = self.chance
        amount = theta[..., -1][..., None, None]
        return mean[..., None, :] + amount * nodes[:, None] * field


def model(d: Design, names: tuple[str, ...]) -> Toy:
    """The toy model with these effects."""
    base = 40.0 * _by(d.quantity, 1.0 * d.height / 30, -0.5 + 0 * d.x, 0.4 * d.height / 30)
    known = fields(d)
    several = [Parameter("kn", "N/m", 0.05, 20.0, 1.0, 1.0, logarithmic=True)]
    parts, chance, weights = [], None, np.ones(1)
    for name in [n for n in names if n not in SCALED]:
        low = -200.0 if name in ("offset", "scale", "clock", "wear", "release") else 0.0
        several.append(Parameter(name, "1", low, 200.0, 2.0))
        parts.append((known[name], name in ("crossley", "plastic")))
    for name in [n for n in names if n in SCALED]:
        nodes, weights = np.polynomial.hermite_e.hermegauss(9)
        weights = weights / weights.sum()
        several.append(Parameter(name, "1", 0.0, 12.0, 1.0))
        field = _by(d.quantity, *SCALED[name]) * d.height / 30
        chance = (nodes, field)
    ordered = tuple(n for n in names if n not in SCALED) + tuple(n for n in names if n in SCALED)
    return Toy(ordered, tuple(several), weights, base, tuple(parts), chance)


@dataclass(frozen=True)
class Square:
    """A model in which one amount, from -5 to 5, enters by its square: two maxima."""

    field: np.ndarray
    effects: tuple[str, ...] = ("square",)
    parameters: tuple[Parameter, ...] = (Parameter("amount", "1", -5.0, 5.0, 1.0),)
    weights: np.ndarray = dc_field(default_factory=lambda: np.ones(1))

    def predict(self, theta: np.ndarray) -> np.ndarray:
        return np.asarray(theta, dtype=float)[..., None] ** 2 * self.field


@dataclass(frozen=True)
class Curve:
    """A polynomial of one to three amounts over evenly spaced rows, the third a refinement."""

    rows: int
    amounts: int
    fails: bool = False
    effects: tuple[str, ...] = ("curve",)
    weights: np.ndarray = dc_field(default_factory=lambda: np.ones(1))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"a{i}", "1", -50.0, 50.0, 1.0) for i in range(self.amounts))

    @property
    def refinement(self) -> Curve | None:
        return replace(self, amounts=3) if self.amounts < 3 else None

    def predict(self, theta: np.ndarray) -> np.ndarray:
        if self.fails and self.amounts == 3:
            raise ComputationError("nothing can be simulated with these")
        powers = np.linspace(-1.0, 1.0, self.rows) ** np.arange(self.amounts)[:, None]
        return (np.asarray(theta, dtype=float) @ powers)[..., None, :]


@dataclass(frozen=True)
class Signed:
    """A level, and an amount whose sign the last four of the rows alone tell."""

    rows: int
    effects: tuple[str, ...] = ("signed",)
    parameters: tuple[Parameter, ...] = (
        Parameter("level", "1", -50.0, 50.0, 1.0),
        Parameter("amount", "1", -5.0, 5.0, 1.0),
    )
    weights: np.ndarray = dc_field(default_factory=lambda: np.ones(1))

    def predict(self, theta: np.ndarray) -> np.ndarray:
        level, amount = np.moveaxis(np.asarray(theta, dtype=float)[..., None], -2, 0)
        row = np.arange(self.rows)
        by_row = np.where(row < self.rows - 4, amount**2 * (-1.0) ** row, 2.0 * amount)
        return (level + by_row)[..., None, :]


@dataclass(frozen=True)
class Scatter:
    """Groups that differ by chance alone, over an even grid of so many nodes a deviation."""

    rows: int
    closer: int = 1
    effects: tuple[str, ...] = ("scatter",)
    parameters: tuple[Parameter, ...] = (Parameter("amount", "1", 0.0, 200.0, 10.0),)

    def finer(self, by: int) -> Scatter:
        return replace(self, closer=by)

    @property
    def nodes(self) -> np.ndarray:
        return np.linspace(-4.0, 4.0, 40 * self.closer + 1)

    @property
    def weights(self) -> np.ndarray:
        mass = np.exp(-0.5 * self.nodes**2)
        return mass / mass.sum()

    def predict(self, theta: np.ndarray) -> np.ndarray:
        amount = np.asarray(theta, dtype=float)[..., None]
        return amount * self.nodes[:, None] * np.ones(self.rows)


NAMES = (*fields(design(np.random.default_rng(0))), *SCALED)
UNLISTED: dict[str, Field] = {
    "bump": lambda d: _by(d.quantity, np.cos(2.5 * d.x), -np.cos(2.5 * d.x), 0 * d.x),
    "wave": lambda d: _by(d.quantity, np.sin(3.3 * d.t), 0 * d.x, 0 * d.x),
    "step": lambda d: _by(d.quantity, 0 * d.x, np.where(d.height > 35, 1.0, 0), 0 * d.x),
    "session": lambda d: _by(d.quantity, np.where(d.t > 0, d.height / 30, 0.0), 0 * d.x, 0 * d.x),
    "alternation": lambda d: _by(d.quantity, d.height / 30 * (-1.0) ** d.order, 0 * d.x, 0 * d.x),
}


def project(field: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """What refitting along tangent (rows, p) leaves of a field (rows,)."""
    return field - tangent @ np.linalg.lstsq(tangent, field, rcond=None)[0]


def noise(rng: np.random.Generator, d: Design, how: str = "normal") -> np.ndarray:
    """Unit noise (rows,), or what a dataset did not declare."""
    e = rng.standard_normal(d.height.size)
    if how == "t3":
        return rng.standard_t(3, e.size)
    if how == "t3 scaled":
        return rng.standard_t(3, e.size) / np.sqrt(3)
    if how == "outliers":
        return np.where(rng.random(e.size) < 0.05, 6 * np.sign(e) + e, e)
    if how == "ar1":
        rho = 0.5
        for each in np.unique(d.quantity):
            mine = np.flatnonzero(d.quantity == each)
            for a, b in itertools.pairwise(mine):
                e[b] = rho * e[a] + np.sqrt(1 - rho**2) * e[b]
    if how == "double":
        return 1.6 * e
    return e


def problem(
    seed: int,
    truth: dict[str, float] | None = None,
    how: str = "normal",
    unlisted: tuple[str, float] | None = None,
    drops: int = 48,
    quantities: int = 2,
    candidates: tuple[str, ...] = NAMES,
    declared: bool = True,
) -> tuple[Problem, dict[str, float]]:
    """A problem and the true amounts. ``truth`` gives d of each effect: it is turned into the
    amount whose projected whitened size is d."""
    rng = np.random.default_rng([7, seed])
    d = design(rng, drops, quantities)
    kn = float(np.exp(rng.uniform(-0.5, 0.5)))
    tangent = np.asarray(model(d, ()).base)[:, None]
    mean = model(d, ()).predict(np.array([kn]))[0]
    amounts: dict[str, float] = {"kn": kn}
    for name, size in (truth or {}).items():
        if name in SCALED:
            field = _by(d.quantity, *SCALED[name]) * d.height / 30
            amounts[name] = _scatter_amount(d, field, size)
            z = rng.standard_normal(d.group.max() + 1)[d.group]
            mean = mean + amounts[name] * z * field
        else:
            field = fields(d)[name]
            a = size / np.linalg.norm(project(field, tangent))
            amounts[name] = float(a)
            mean = mean + a * field
    if unlisted is not None:
        field = UNLISTED[unlisted[0]](d)
        span = [tangent] + [fields(d)[n][:, None] for n in NAMES if n not in SCALED]
        mean = mean + unlisted[1] * field / _perp(field, span)
    values = mean + noise(rng, d, how)
    guess = 1.0 if declared else 2.5
    singles = [model(d, (name,)) for name in candidates]
    made = Problem(
        values=values if declared else values / guess,
        scale=np.full(values.size, 0.1),
        unit="mm",
        quantity=np.array(["y1", "time", "force"])[d.quantity],
        group=d.group.astype(np.int64),
        covariates={"height": d.height, "order": d.order.astype(float)},
        baseline=model(d, ()) if declared else Shrunk(model(d, ()), guess),
        candidates=singles if declared else [Shrunk(m, guess) for m in singles],
        combine=lambda names: model(d, names) if declared else Shrunk(model(d, names), guess),
        experiments=[
            Experiment("more heights", lambda found: model(_wider(d), found.effects)),
            Experiment("the same again", lambda found: model(d, found.effects)),
        ],
        sigma_declared=declared,
        notes={"mean": mean if declared else mean / guess},
    )
    return made, amounts


@dataclass(frozen=True)
class Derived:
    """A toy under another name; a subclass says what it predicts."""

    toy: Toy

    @property
    def effects(self) -> tuple[str, ...]:
        return self.toy.effects

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.toy.parameters

    @property
    def weights(self) -> np.ndarray:
        return self.toy.weights


@dataclass(frozen=True)
class Shrunk(Derived):
    """A toy in units of a sigma that was only guessed."""

    guess: float

    def predict(self, theta: np.ndarray) -> np.ndarray:
        return self.toy.predict(theta) / self.guess


@dataclass(frozen=True)
class Mixed(Derived):
    """A toy whose rows come in another order."""

    order: np.ndarray

    def predict(self, theta: np.ndarray) -> np.ndarray:
        return self.toy.predict(theta)[..., self.order]


def _wider(d: Design) -> Design:
    return Design(d.height * 4, d.order, d.quantity, d.group)


def _perp(field: np.ndarray, span: list[np.ndarray]) -> float:
    """Distance of a field to the nearest single effect beside the baseline."""
    return min(
        float(np.linalg.norm(project(field, np.hstack([span[0], each])))) for each in span[1:]
    )


def _scatter_amount(d: Design, field: np.ndarray, size: float) -> float:
    """The amount at which twice the divergence from no scatter is size²."""
    power = np.bincount(d.group, field**2)
    return brentq(
        lambda a: np.sum(a**2 * power - np.log1p(a**2 * power)) - size**2, 0.0, 100.0, xtol=1e-14
    )
