"""Datasets whose truth is hidden: drops and films with nothing, listed effects, or a misfit.

Every dataset has a random stream of its own, from a seed and a constant that nothing else uses;
design, body, stiffness, noise and misfit are drawn from it. A misfit is scaled until its size d is
the one that its row asks for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .body import Array, Body
from .drops import LAWS, LISTED, Listed, Truth, seen, with_effect
from .read import FORCE, TIME, Y1, Found, Made, Plan, Row, measured
from .shapes import FAMILIES, Drops, impossible, unlisted
from .size import Gauge, plain, size, whitened
from .upright import GRAVITY_M_S2

TAG = 0xB11D_F01D
TRIES = 60
# Effects that a table of heights shows by its level alone: Kn is declared there.
LEVEL = ("contact_damping", "material_damping", "hysteretic_damping", "bristle_tilt")
# What else an effect needs to be seen at all.
NEEDS = {"scale_error": FORCE, "clock_error": TIME}
LEANING = ("bristle_tilt", "surface_slope")
# Of these a drop here has one: laws of the contact, and what leans on a spring alone.
ONE_OF = (*LAWS, *LEANING)
FRICTIONS = (0.0, 0.2, 0.5)
FILMED = (
    "air_drag",
    "release_velocity",
    "height_offset",
    "hunt_crossley",
    "stiffening_contact",
    "plastic_contact",
    "adhesion",
    "surface_phases",
    "wear",
)


ROWS = {
    each.name: each
    for each in (
        Row("clean", "nothing", noises="gaussian"),
        Row("noise", "nothing", noises="unknown"),
        Row("gross", "gross", (16.0, 150.0), noises="gaussian"),
        Row("listed16", "listed", (16.0, 40.0)),
        Row("listed8", "listed", (8.0, 8.0)),
        Row("unlisted16", "unlisted", (16.0, 40.0)),
        Row("unlisted8", "unlisted", (8.0, 8.0)),
        Row("films", "nothing", films=True),
        Row("films16", "listed", (16.0, 40.0), films=True),
        Row("pairs", "pair", (6.0, 40.0)),
    )
}


class NoDesign(RuntimeError):
    """None of the designs that were drawn for a dataset has a misfit of the size asked for."""


def stream(seed: int, row: str, number: int) -> np.random.Generator:
    """The dataset's own random stream."""
    key = (list(ROWS).index(row), number)
    return np.random.default_rng(np.random.SeedSequence([TAG, seed], spawn_key=key))


def make(seed: int, row: str, number: int) -> Made:
    """Dataset ``number`` of a row; the same arguments give the same dataset.

    Raises RuntimeError where no design of many carries the size that is asked for.
    """
    rng, asked = stream(seed, row, number), replace(ROWS[row], others=_others(seed))
    names = FILMED if asked.films else tuple(LISTED)
    name, family = _turn(names, seed, number), _turn(tuple(FAMILIES), seed, number)
    for _ in range(TRIES):
        if asked.holds == "nothing":
            plan = _plan(rng, asked)
            clear = seen(plan.truth, plan.heights_m, plan.chance)
            return measured(rng, asked, number, plan, Found(clear, "nothing", 0.0))
        target = math.exp(rng.uniform(*np.log(asked.d)))
        if asked.holds == "listed":
            found = _listed(rng, asked, LISTED[name], target)
        elif asked.holds == "pair":
            found = _pair(rng, asked)
        elif asked.holds == "unlisted":
            found = _unlisted(rng, asked, family, target)
        else:
            found = _gross(rng, asked, seed, number, target)
        if found is not None:
            return measured(rng, asked, number, *found)
    raise NoDesign(f"{row} {number}: no design has the size asked for, of {name} or {family}")


def _turn(names: tuple[str, ...], seed: int, number: int) -> str:
    """The ``number``-th of the names, each in its turn, in an order that the seed draws: the first
    datasets of a row are a fair sample of all."""
    key = (len(ROWS), len(names))
    rng = np.random.default_rng(np.random.SeedSequence([TAG, seed], spawn_key=key))
    return names[rng.permutation(len(names))[number % len(names)]]


def _plan(rng: np.random.Generator, row: Row, *names: str) -> Plan:
    """A design in which the effects ``names`` can be seen."""
    leans = bool(set(names) & set(LEANING))
    body = _body(rng, row, leans)
    # a film shows heights alone
    needed = {NEEDS[name] for name in names if name in NEEDS}
    columns = (Y1,) if row.films else _columns(rng, needed)
    n = int(rng.integers(8, 17)) if row.films else 48
    if not row.films and rng.random() < 0.4:
        n = int(rng.integers(8, 49))
    low, high = (0.03, 0.15) if row.films else (0.01, 0.05)
    if "air_drag" in names:
        low, high = 0.2, rng.uniform(0.6, 1.0)
    elif "hunt_crossley" in names and rng.random() < 0.5:
        high *= 2.5
    heights = rng.uniform(low, high, size=n)
    if rng.random() < 0.6:
        levels = np.linspace(low, high, int(rng.integers(4, 10)))
        heights = rng.permutation(np.resize(levels, n)) + 5e-4 * rng.normal(size=n)
    kn = 10.0 ** rng.uniform(math.log10(5e4), math.log10(2e7))
    # of no account to what stands upright, but it may be declared
    friction = float(rng.choice(FRICTIONS)) if leans else FRICTIONS[-1]
    truth = Truth(body=body, kn_N_m=kn, friction=friction)
    declared = columns == (Y1,) and not row.films and bool(set(names) & set(LEVEL))
    gauge = Gauge(
        body,
        columns,
        sigma_y_m=float(f"{rng.uniform(1e-4, 5e-4):.3g}"),
        sigma_t_s=float(f"{math.exp(rng.uniform(math.log(4e-7), math.log(2e-6))):.3g}"),
        sigma_force_N=float(f"{rng.uniform(0.2, 1.0):.3g}"),
        kn_N_m=kn if declared or (not names and rng.random() < 0.1) else None,
    )
    chance = rng.normal(size=(n, 2))
    return Plan(truth, gauge, heights, chance, bool(rng.random() < (0.5 if leans else 0.2)))


def _others(seed: int) -> tuple[Body, ...]:
    """Bodies beside the paper's: two flat ones and two wires, the same for all datasets of a seed,
    since whatever reads them makes tables for a body once."""
    rng = np.random.default_rng(np.random.SeedSequence([TAG, seed], spawn_key=(len(ROWS),)))
    bodies = []
    for flat in (True, True, False, False):
        length, beta = _digits(rng.uniform(0.12, 0.5)), _digits(10.0 ** rng.uniform(-5.6, -4.9))
        if flat:
            width, thick = _digits(rng.uniform(1.5e-3, 3e-3)), _digits(rng.uniform(4e-4, 8e-4))
            bodies.append(Body(length, width, thick, beta_s=beta))
        else:
            wire = _digits(rng.uniform(0.6e-3, 1.5e-3))
            bodies.append(Body(length, diameter_m=wire, beta_s=beta))
    return tuple(bodies)


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


def _body(rng: np.random.Generator, row: Row, leans: bool) -> Body:
    """The paper's bristle in two of three, else another; only flat ones lean."""
    if rng.random() < 2.0 / 3.0:
        return Body()
    allowed = [each for each in row.others if each.diameter_m is None or not leans]
    return allowed[int(rng.integers(len(allowed)))]


def _columns(rng: np.random.Generator, needed: set[int]) -> tuple[int, ...]:
    every = [(Y1,), (Y1, TIME), (Y1, FORCE), (Y1, TIME, FORCE)]
    allowed = [each for each in every if needed <= set(each)]
    return allowed[int(rng.integers(len(allowed)))]


def _listed(
    rng: np.random.Generator, row: Row, effect: Listed, target: float
) -> tuple[Plan, Found] | None:
    """A design with a listed effect of size ``target``; None where its bounds do not allow it."""
    plan = _plan(rng, row, effect.name)
    value = _values(rng, effect, plan.truth.body)
    hardens, unloads = 0.0, 1.0
    if effect.name == "plastic_contact":
        hardens, unloads = float(rng.choice((0.0, 0.05, 0.1))), float(rng.choice((1.0, 1.5, 3.0)))
        plan = replace(plan, truth=replace(plan.truth, hardens=hardens, unloads=unloads))
    ideal = (hardens, unloads) == (0.0, 1.0)

    def clear(share: float) -> Array:
        truth = with_effect(plan.truth, effect.name, value(share))
        return seen(truth, plan.heights_m, plan.chance)

    share = _scaled(lambda s: size(plan.gauge, clear(s)), target)
    if share is None:
        return None
    plan = replace(plan, truth=with_effect(plan.truth, effect.name, value(share)))
    data = clear(share)
    # of another law the program's yield force is not that force
    true = {effect.parameter: value(share)} if ideal else {}
    return plan, Found(data, effect.name, size(plan.gauge, data), true=true)


def _values(rng: np.random.Generator, effect: Listed, body: Body) -> Callable[[float], float]:
    """An effect's parameter by the share of its way from absence to one of its bounds."""
    absent, ends = effect.absent, [effect.low, effect.high]
    if effect.name == "material_damping":
        absent = body.beta_s
    end = float(rng.choice([each for each in ends if each != absent]))
    if effect.name == "release_velocity":
        end = effect.high  # pushed up, it comes back as fast

    def value(share: float) -> float:
        if effect.logarithmic:
            return absent * (end / absent) ** share
        return absent + share * (end - absent)

    return value


def _pair(rng: np.random.Generator, row: Row) -> tuple[Plan, Found] | None:
    """A design with two listed effects, each of the size asked for with the other there; None where
    it is not."""
    names = [str(each) for each in rng.choice(list(LISTED), size=2, replace=False)]
    if set(names) <= set(ONE_OF) and set(names) != set(LEANING):
        return None
    plan = _plan(rng, row, *names)
    values = [_values(rng, LISTED[name], plan.truth.body) for name in names]

    def clear(shares: Array) -> Array:
        truth = plan.truth
        for name, value, share in zip(names, values, shares, strict=True):
            truth = with_effect(truth, name, value(share)) if share else truth
        return seen(truth, plan.heights_m, plan.chance)

    shares = np.zeros(2)
    for i, alone in enumerate(np.eye(2)):
        target = math.exp(rng.uniform(*np.log(row.d)))

        def alone_d(share: float, alone: Array = alone) -> float:
            return size(plan.gauge, clear(share * alone))

        share = _scaled(alone_d, target)
        if share is None:
            return None
        shares[i] = share
    data = clear(shares)
    conditional = [beside(plan, clear, shares, i) for i in range(2)]
    if min(conditional) < row.d[0]:
        return None
    truth = plan.truth
    for name, value, share in zip(names, values, shares, strict=True):
        truth = with_effect(truth, name, value(share))
    true = {LISTED[n].parameter: v(s) for n, v, s in zip(names, values, shares, strict=True)}
    if len(true) < 2 or "plastic_contact" in names:
        true = {}
    found = Found(data, " with ".join(names), min(conditional), true=true)
    return replace(plan, truth=truth), found


def beside(plan: Plan, clear: Callable[[Array], Array], shares: Array, which: int) -> float:
    """The size of one of two effects where the other is there: what its absence moves, less what
    Kn and the other follow of it."""
    data, other = clear(shares), 1 - which
    without, more = shares.copy(), shares.copy()
    without[which], more[other] = 0.0, 1.05 * shares[other]
    moves = [clear(without) - data, clear(more) - data]
    if plan.gauge.kn_N_m is None:
        stiffer = plain(plan.truth.body, math.log10(plan.truth.kn_N_m) + 0.01, data[:, 0])
        stiffer /= plain(plan.truth.body, math.log10(plan.truth.kn_N_m), data[:, 0])
        moves.append(np.hstack([np.zeros((len(data), 1)), data[:, 1:] * (stiffer - 1.0)]))
    moved, *follow = whitened(plan.gauge, data, moves)
    left = moved - np.stack(follow, 1) @ np.linalg.lstsq(np.stack(follow, 1), moved)[0]
    return float(np.linalg.norm(left))


def _unlisted(
    rng: np.random.Generator, row: Row, family: str, target: float
) -> tuple[Plan, Found] | None:
    """A design with an unlisted shape in one of the columns."""
    plan = _plan(rng, row, "")
    plan = replace(plan, gauge=replace(plan.gauge, kn_N_m=None))
    base = seen(plan.truth, plan.heights_m, plan.chance)
    drops = Drops(plan.heights_m, np.sqrt(2.0 * GRAVITY_M_S2 * plan.heights_m))
    columns = plan.gauge.columns
    column = 1 + (Y1 if rng.random() < 0.6 else int(rng.choice(columns)))
    shape = unlisted(family, drops, base[:, column], rng)

    def clear(share: float) -> Array:
        data = base.copy()
        data[:, column] = np.maximum(data[:, column] + share * shape, 0.0)
        return data

    share = _scaled(lambda s: size(plan.gauge, clear(s)), target)
    if share is None:
        return None
    return plan, Found(clear(share), family, size(plan.gauge, clear(share)), column - 1)


def _gross(
    rng: np.random.Generator, row: Row, seed: int, number: int, target: float
) -> tuple[Plan, Found] | None:
    """A misfit of level, of scale or of shape."""
    which = ("impossible", "level", "body", "shape")[number % 4]
    if which == "shape":
        return _unlisted(rng, row, _turn(tuple(FAMILIES), seed, number // 4), target)
    plan = _plan(rng, row, "")
    if which == "impossible":
        truth, gauge = replace(plan.truth, body=Body()), replace(plan.gauge, body=Body())
        plan = replace(plan, truth=truth, gauge=replace(gauge, kn_N_m=None))
        data = seen(plan.truth, plan.heights_m, plan.chance)
        name, data[:, 1] = impossible(data[:, 0], rng)
    elif which == "level":
        plan = replace(plan, gauge=replace(plan.gauge, kn_N_m=plan.truth.kn_N_m))
        data = seen(plan.truth, plan.heights_m, plan.chance)
        name, up = "level, Kn declared", rng.choice([-1.0, 1.0])
        share = _scaled(lambda s: size(plan.gauge, _raised(data, up * s)), target)
        if share is None:
            return None
        data = _raised(data, up * share)
    else:
        columns = (Y1, TIME, FORCE) if rng.random() < 0.5 else (Y1, TIME)
        # as a scale misread, by one of two amounts
        factor = (0.87, 1.13)[int(rng.integers(2))]
        other = replace(plan.truth.body, length_m=_digits(factor * plan.truth.body.length_m))
        gauge = replace(plan.gauge, columns=columns, body=other, kn_N_m=None)
        plan, name = replace(plan, gauge=gauge), "length declared wrong"
        data = seen(plan.truth, plan.heights_m, plan.chance)
    d = size(plan.gauge, data)
    return (plan, Found(data, name, d)) if d >= row.d[0] else None


def _raised(data: Array, share: float) -> Array:
    out = data.copy()
    out[:, 1] *= 1.0 + share
    return out


def _scaled(of: Callable[[float], float], target: float) -> float | None:
    """A share from 0 to 1 at which ``of`` is ``target`` within some percent; None if 1 is less.

    By the secant in logarithms, within a bracket.
    """
    low, high = 1e-4, 1.0
    at_high = of(high)
    if not at_high >= target:
        return None
    at_low, share = 1e-3 * target, high
    for _ in range(14):
        slope = math.log(at_high / at_low) / math.log(high / low)
        step = math.log(target / at_low) / max(slope, 1e-3)
        share = low * math.exp(np.clip(step, 0.1, math.log(high / low) - 0.02))
        reached = max(of(share), 1e-9)
        if abs(reached / target - 1.0) < 0.04:
            return share
        if reached < target:
            low, at_low = share, reached
        else:
            high, at_high = share, reached
    return None
