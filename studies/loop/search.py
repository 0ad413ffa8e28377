"""Search over explanations: each candidate fitted from wide starts, then pairs that would gain.

Where an effect would take the baseline's own parameters cannot be told from the fit without it, so
starts are spread over the whole box of the baseline, and the best few that differ are followed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from scipy.stats import qmc

from ...solver.arrays import Array
from ...solver.errors import ComputationError
from ..running.threads import in_threads
from .fit import Chosen, Fitted, fit, settle, to_box, to_theta
from .posterior import evidence
from .problem import Emulated, Model, Problem, Refinable, Scattering
from .profile import Profile
from .sample import Sample

SPREAD = 8
# An effect of several parameters has narrow valleys: starts lie so many times as close, and so many
# times as many are followed.
CLOSER, MORE = 4, 5
LEVELS = (0.03, 0.12, 0.35, 0.8)
# Beside the baseline's fit an effect is tried at these shares of its range. One that acts beyond a
# threshold alone changes nothing over most of it. One that differs by chance has no threshold.
AMOUNTS = tuple(share / 50 for share in range(1, 51))
# Where an effect's other parameters begin, beside their typical values; and those that refine it.
OTHERS, REFINING = (0.1, 0.9), (0.1, 0.4, 0.7)
FOLLOWED = 8
DIFFERENT = 0.08
# Of a fit that begins anywhere, for each of its two halves.
ANEW = 128
# Predictions of neighbouring nodes may lie so many standard deviations of the noise apart (a sum
# over them is then within 3e-4 of a normal likelihood's integral), and nodes are this share of the
# deviation by chance apart.
NODES_APART, NODE_SHARE, MOST_CLOSER = 1.5, 0.2, 16
# What tables are off by may have put a model that is right below the likeliest by so many nats, or
# by this share of what that gains over none; and it is fitted so often to simulations.
TABLE_NATS, TABLE_SHARE, SIMULATED = 30.0, 0.1, 8
# After so many simulations it is seen whether a fit is of any use.
SOON = 3
# A fit that moves by less of what the data leave uncertain is not simulated again.
SETTLED = 0.1
# Pairs are followed from so many starts by so many steps first, which may leave them so many nats
# too low; at most so many are fitted then.
FEW_FOLLOWED, FIRST_STEPS, FIRST_NATS, MOST_PAIRS = 4, 4, 5.0, 24
# Standard errors by which a share of the rows has to show that a pair falls short.
SURE = 3.0
# Tables of a pair may be off by this share more or less than those of its parts.
PAIR_OFF = 0.5


@dataclass(frozen=True)
class Tried:
    """A model that was fitted, and its log evidence; where that was to simulations, also the fit
    to ``tables``."""

    fitted: Fitted
    log_evidence: float
    tables: Fitted | None = None

    @property
    def effects(self) -> tuple[str, ...]:
        return self.fitted.effects

    @property
    def corrected(self) -> float:
        """How many nats likelier simulations made it; zero where none were asked for."""
        if self.tables is None:
            return 0.0
        return self.fitted.log_likelihood - self.tables.log_likelihood


def spread(parameters: int, points: int = SPREAD) -> Array:
    """Points (n, parameters) spread over the unit box, always the same: ``points`` of them for one
    parameter, twice as many for more."""
    if parameters == 1:
        return (np.arange(points)[:, None] + 0.5) / points
    drawn = qmc.Sobol(parameters, scramble=False).random(2 * points)
    return np.asarray(0.05 + 0.9 * drawn)


def fit_baseline(data: Sample, model: Model) -> Fitted:
    """The baseline's fit, from its typical values and from all over its box."""
    typical = np.array([[to_box(each, each.typical) for each in model.parameters]])
    return _followed(data, model, np.concatenate([typical, spread(typical.size)]))


def fit_candidate(data: Sample, base: Fitted, profile: Profile) -> Tried:
    """One effect's fit, from its profile above the baseline, from any amount and from elsewhere."""
    own = base.u.size
    model = resolved(data, base, profile.model)
    starts = [profile.u, _everywhere(spread(own), _levels(model, own, OTHERS))]
    if np.asarray(model.weights).size == 1:
        starts.append(_everywhere(base.u[None], _levels(model, own, OTHERS, AMOUNTS)))
    fitted = _followed(data, model, np.concatenate(starts))
    return Tried(fitted, evidence(fitted, own))


def fit_refined(data: Sample, base: Fitted, tried: Tried) -> Tried:
    """An effect's fit with the parameters that refine it, to simulations; as it was, where there
    are none, too many drops fail with them, or it is not likelier."""
    model = tried.fitted.model
    if not isinstance(model, Refinable) or (refined := model.refinement) is None:
        return tried
    own = base.u.size
    spread_out = _everywhere(spread(own, CLOSER * SPREAD), _levels(refined, own, REFINING))
    beside = _everywhere(base.u[None], _levels(refined, own, REFINING, AMOUNTS))
    try:
        fitted = _followed(data, refined, np.concatenate([spread_out, beside]), MORE * FOLLOWED)
    except ComputationError:
        return tried
    found = fit_simulated(data, base, Tried(fitted, evidence(fitted, own)))
    return found if found.log_evidence > tried.log_evidence else tried


def fit_anew(data: Sample, model: Model, last: Array) -> Fitted:
    """A model's fit from all over its box, and from where another sample's fit was ``last`` (p,):
    of maxima that are equally likely, that comes last."""
    return _followed(data, model, np.concatenate([spread(last.size, ANEW), last[None]]))


def _everywhere(points: Array, levels: Array) -> Array:
    """Each of the baseline's points (n, p) with each of an effect's (m, q): (n m, p + q)."""
    return np.hstack([np.repeat(points, len(levels), axis=0), np.tile(levels, (len(points), 1))])


def resolved(data: Sample, base: Fitted, model: Model) -> Model:
    """The model with nodes of chance as near each other as these data ask for, were all that the
    baseline leaves of a group made by chance."""
    if np.asarray(model.weights).size == 1 or not isinstance(model, Scattering):
        return model
    misfit = np.sqrt(np.add.reduceat((data.values - base.mean) ** 2, data.starts[:-1]))
    deviation = 0.5 * float(np.quantile(misfit, 0.95))
    closer = int(np.ceil(NODE_SHARE * deviation / NODES_APART))
    return model.finer(min(closer, MOST_CLOSER)) if closer > 1 else model


def chosen(every: Sample, beside: Fitted, model: Model) -> Model:
    """The model as all data choose it beside a fit of its other effects; itself where they choose
    nothing, or the fit has that effect itself."""
    if not _chooses(model) or _chooses(beside.model):
        return model
    there = fit(every, beside.model, beside.u, beside.noise, iterations=0)
    return model.chosen(every, there)


def _chooses(model: Model) -> TypeGuard[Chosen]:
    return isinstance(model, Chosen) and model.choices > 1


def _levels(
    model: Model, own: int, others: Sequence[float], shares: Sequence[float] = LEVELS
) -> Array:
    """Points (n, q) of an effect's parameters, at ``shares`` of the way from its absence to both
    bounds of the first, the others typical or each at one of ``others``."""
    several = model.parameters[own:]
    typical = np.array([to_box(each, each.typical) for each in several])
    null = to_box(several[0], several[0].null)
    out = []
    for end in (0.0, 1.0):
        if abs(end - null) > 1e-9:
            for share in shares:
                first = null + share * (end - null)
                rest = [tuple(typical[1:])]
                if len(several) > 1:
                    rest += itertools.product(others, repeat=len(several) - 1)
                out += [(first, *each) for each in rest]
    return np.array(out)


def _followed(data: Sample, model: Model, starts: Array, most: int = FOLLOWED) -> Fitted:
    """The fit from the best few, at ``most``, of many starts (n, p) that differ from each other."""
    few = data.first
    found = settle(few, model, starts[_likeliest(few, model, starts, most)])
    return found if few is data else settle(data, model, np.array([found.u, *found.modes]))


def _likeliest(data: Sample, model: Model, starts: Array, most: int) -> list[int]:
    """The numbers of the likeliest starts (n, p) that differ from each other, at ``most``."""
    noise = np.zeros(1, dtype=np.int64)
    weights = np.asarray(model.weights)
    logs = data.heights(
        data.values[None], data.predict(model, to_theta(model.parameters, starts)), weights, noise
    )[:, 0]
    chosen: list[int] = []
    for i in np.argsort(-logs, kind="stable"):
        if all(np.max(np.abs(starts[i] - starts[j])) > DIFFERENT for j in chosen):
            chosen.append(int(i))
        if len(chosen) == most:
            break
    return chosen


def near_likeliest(tried: Sequence[Tried], plain: float) -> float:
    """The log evidence from which on tables may have put a model below the likeliest; ``plain`` is
    the baseline's."""
    best = max((each.log_evidence for each in tried), default=plain)
    return best - max(TABLE_NATS, TABLE_SHARE * (best - plain))


def fit_simulated(data: Sample, base: Fitted, tried: Tried, least: float = -np.inf) -> Tried:
    """The model fitted again, to simulations at its fit; where that does not settle, or is soon
    seen not to reach the log evidence ``least``, at the likeliest of the points that were
    simulated."""
    fitted, best = tried.fitted, tried.fitted
    most = -np.inf
    for turn in range(SIMULATED):
        if not isinstance(fitted.model, Emulated):
            return tried
        model = fitted.model.simulated(fitted.theta)
        if model is fitted.model:
            return tried
        here = fit(data, model, fitted.u, fitted.noise, iterations=0)
        if here.height > most:
            best, most = here, here.height
        if turn + 1 >= SOON and most < least:
            break
        fitted = settle(data, model, np.array([here.u, *fitted.modes]))
        moved = fitted.u - here.u
        if moved @ fitted.information @ moved < SETTLED**2:
            best = fitted
            break
    return Tried(best, evidence(best, base.u.size), tried.fitted)


def fit_pairs(
    problem: Problem,
    data: Sample,
    every: Sample,
    base: Fitted,
    singles: Sequence[Tried],
    profiles: Sequence[Profile],
    plain: float,
    least: float,
) -> list[Tried]:
    """Fits of the pairs of effects whose log evidence may be ``least`` or more, to simulations
    where they are likely; ``plain`` is the baseline's. They are fitted to ``data``, a part of
    ``every``."""
    few, share = data.first, TABLE_SHARE * (least - plain)
    alone = {each.effects[0]: each for each in singles}
    by_name = {each.name: each for each in profiles}
    best = max(singles, key=lambda each: each.log_evidence)
    noise = best.fitted.noise
    reached = best.log_evidence
    if few is not data:
        again = fit(few, best.fitted.model, best.fitted.u, noise, iterations=0)
        reached = evidence(again, base.u.size)

    def of_all(height: float) -> float:
        """Log evidence that all rows may give where those that fits begin on give ``height``: as
        much more than the best single effect's as there are more rows, and `SURE` standard errors.
        (The variance of a logarithm of a likelihood ratio is about twice its mean.)"""
        more = height - reached
        error = math.sqrt(2.0 * max(abs(more), 1.0) * (1.0 - 1.0 / data.times))
        return best.log_evidence + data.times * (more + SURE * error)

    begun: list[tuple[float, Model, Array]] = []
    for names in itertools.combinations(alone, 2):
        model = problem.combine(names)
        if isinstance(model, Emulated) and not model.possible:
            continue
        for name in names:
            model = chosen(every, alone[name].fitted, model)
        starts = _pair_starts(model, base, alone, by_name)
        starts = starts[_likeliest(few, model, starts, FEW_FOLLOWED)]
        # of many nodes the likeliest start alone
        several = FEW_FOLLOWED if np.asarray(model.weights).size == 1 else 1
        first = fit(few, model, starts[:several], noise, FIRST_STEPS)
        height = of_all(evidence(first, base.u.size))
        if height + _correctable(alone, names, share) >= least - FIRST_NATS:
            begun.append((height, model, np.concatenate([first.u[None], starts])))
    begun.sort(key=lambda each: -each[0])
    found = []
    for _, model, starts in begun[:MOST_PAIRS]:
        model = resolved(data, base, model)
        fitted = settle(few, model, starts)
        if few is not data:
            most = of_all(evidence(fitted, base.u.size))
            if most + _correctable(alone, model.effects, share) < least - FIRST_NATS:
                continue
            fitted = settle(data, model, np.array([fitted.u, *fitted.modes]))
        found.append(Tried(fitted, evidence(fitted, base.u.size)))
    hoped = [each.log_evidence + _correctable(alone, each.effects, share) for each in found]
    near = max((each.log_evidence for each in found), default=least) - FIRST_NATS
    likely = [e for e, most in zip(found, hoped, strict=True) if most >= min(near, max(hoped))]
    return list(in_threads(lambda each: fit_simulated(data, base, each, least), likely))


def _correctable(alone: Mapping[str, Tried], effects: Sequence[str], share: float) -> float:
    """How many nats simulations may make of a pair beyond tables: what they made of its parts, and
    for what one effect does to the other `PAIR_OFF` of that, or ``share`` if that is more."""
    parts = np.array([alone[name].corrected for name in effects])
    return float(parts.sum() + max(PAIR_OFF * np.abs(parts).sum(), share))


def _pair_starts(
    model: Model, base: Fitted, alone: dict[str, Tried], known: dict[str, Profile]
) -> Array:
    """Each effect as it was alone, with several amounts of the other beside it."""
    own = base.u.size
    names = model.effects
    out = []
    for first, second in (names, names[::-1]):
        one = known[first].model.parameters[own:]
        null = np.array([to_box(each, each.null) for each in one])
        profile = known[second]
        fits = [each for each in (alone[first].fitted, alone[first].tables) if each is not None]
        for fitted, amount in itertools.product(fits, (1.0, 0.5)):
            part = null + amount * (fitted.u[own:] - null)
            for point in range(0, len(profile.u), 3):
                parts = {first: part, second: profile.u[point, own:]}
                for start in (fitted.u[:own], profile.u[point, :own]):
                    out.append(np.concatenate([start, *(parts[name] for name in names)]))
    return np.array(out)
