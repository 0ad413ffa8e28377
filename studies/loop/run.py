"""The loop from a `Problem` to a `Finding`: fit, test, explain, test again, score on held-out data.

Nothing is adequate, and no effect is named by itself, unless what is left of the fitted data passes
the absolute tests (`adequacy`) and the held-out data are predicted as their noise allows. An effect
has to pay as well: the log score of the held-out data rises by more than their noise can make of
it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ...solver.arrays import Array
from ..running.threads import in_threads
from .adequacy import WIDER_NOISE, Adequacy, assess
from .experiment import next_experiment
from .explain import (
    UNLISTED_MARGIN,
    Explanation,
    State,
    against,
    effect_cost,
    explain,
    missing_otherwise,
    named,
    probabilities,
    shares_of,
)
from .finding import Evidence, Finding, Interval, Near, Verdict, p_text
from .fit import Chosen, settle
from .heldout import Gain, HeldOut, Judge, rms, split
from .noise import Ints
from .posterior import Posterior, posterior
from .problem import Entry, Problem
from .profile import Profile, classes, directions, profile
from .sample import Sample, estimated_units, sample
from .scatter import FAR_SMALLER, Scatter
from .search import Tried, chosen, fit_baseline, fit_candidate, fit_simulated, near_likeliest
from .slips import FEWEST, are_too_many, could_be_anything

ALARM = 0.01
# Nats that scatter must gain over all else to be missing where no test finds it.
SCATTER_GAIN = 8.0
# The chance of an effect's own test from which on it may gain these: they are one of 6e-5.
SCATTER_ODD = 0.01
# Nats by which an explanation that was refused is worth a second look.
LIKELIER = 1.0
# Nats by which noise must be likelier than that of a normal distribution to be said to be another.
CLEARLY = 3.0
# Beyond so many nats nobody wants to know how many times.
MANY = math.log(1e3)
# How often errors are held against the scatter again until they match it.
MATCHED = 3
# Nats by which of two explanations one is hardly likelier.
CLOSE = 3.0
# Declared standard deviations by which a few values are worth a second look.
FAR_OFF, FEW = 6.0, 2
ROUGH = "these data leave the parameters so loose that the ends of their intervals are rough"
BARE = "as many free parameters as values to fit: whatever is missing, these data could not show it"


def pieces(problem: Problem) -> int:
    """Of how much work `find` tells."""
    return 2 * len(problem.candidates) + 2


def find(
    problem: Problem,
    seed: int = 0,
    alarm: float = ALARM,
    advance: Callable[..., None] = lambda count=1: None,
) -> Finding:
    """Run the loop.

    ``alarm`` is the rate at which data that lack nothing are said to lack something. The same
    problem, seed and rate give the same finding to the bit. ``advance`` is called as `pieces` get
    done, with their number where it is not one.

    Where values scatter about a smooth course by far less than was declared, the declared errors
    are wrong, and the data's own are taken. Where they scatter by more, that may be physics: the
    data's own are taken if what they lead to is likelier than all else, the cost of errors of any
    size included. Drops that differ by chance look much like that, and have to be likelier by
    `UNLISTED_MARGIN`. What is left has to be independent: noise may be odd, or larger than was
    declared, but not both.
    """
    problem = problem.once()
    if problem.records:
        return _of_records(problem, seed, alarm, advance)
    told = Scatter.each(problem)
    smaller = [each for each in told if each.far_smaller]
    larger = [each for each in told if each.larger]
    known = _with(problem, smaller)
    found, wrong, doubt = _find(known, seed, alarm, advance), smaller, ""
    if larger:
        wider = _with(problem, [*smaller, *larger])
        # errors that are too small make slips of what is none: compared are those in both
        both = np.intersect1d(known.groups, wider.groups)
        narrow = _limited_to(known, both)
        before = found if both.size == known.groups.size else _find(narrow, seed, alarm)
        wide = replace(_limited_to(wider, both), held=tuple(map(int, split(narrow, seed)[1])))
        other = _find(wide, seed, alarm)
        gain = _gain(other, wide, before, narrow) - sum(each.cost for each in larger)
        by_chance = np.asarray(found.model.weights).size > 1
        enough = -UNLISTED_MARGIN if by_chance else 0.0
        if gain > enough and both.size < wider.groups.size:
            other = _find(wider, seed, alarm)
            gain = gain if _explains(other) else -np.inf
        if gain > enough:
            if gain < CLOSE and found.reported:
                names = " or ".join(" with ".join(each) for each in found.reported)
                doubt = f"with the errors as declared, {names} explains these data nearly as well"
            found, wrong = other, [*smaller, *larger]
        elif gain > -CLOSE:
            bars = " and ".join(each.would_be() for each in larger)
            doubt = f"{bars} would explain these data nearly as well"
    words = [*(each.words() for each in wrong), *filter(None, [doubt])]
    return replace(found, warnings=(*words, *found.warnings))


def _with(problem: Problem, told: Sequence[Scatter]) -> Problem:
    """The problem with errors as large as values scatter, of the quantities that are told.

    The error of the height before has a share in what they scatter by, which is not theirs.
    """
    if not told or problem.with_sigma is None:
        return problem
    times = {each.quantity: each.ratio for each in told}
    for _ in range(MATCHED):
        again = {each.quantity: each.ratio for each in Scatter.each(problem.with_sigma(times))}
        times = {name: size * again.get(name, 1.0) for name, size in times.items()}
    return problem.with_sigma(times)


def _limited_to(problem: Problem, groups: Ints) -> Problem:
    """The problem without its other groups."""
    others = np.setdiff1d(problem.groups, groups)
    return replace(problem, aside=(*problem.aside, *map(int, others)))


def _explains(found: Finding) -> bool:
    """Whether a finding leaves noise that is independent from one drop to the next."""
    return found.verdict is not Verdict.UNKNOWN and float(found.noise["correlation"]) <= 0.0


def _gain(other: Finding, wider: Problem, found: Finding, known: Problem) -> float:
    """By how many nats a finding from ``wider`` errors is likelier than the one from those that are
    ``known``; minus infinity where it is none."""
    if not _explains(other):
        return -np.inf
    density = float(np.log(wider.scale[other.rows] / known.scale[found.rows]).sum())
    return _support(other, wider) - density - _support(found, known)


def _support(found: Finding, problem: Problem) -> float:
    """Log evidence of what a finding stands on, with the prior on the number of effects: of what it
    reports, of the baseline where nothing is missing, else of all that was tried, shapes that no
    effect has among it."""
    cost = effect_cost(len(problem.candidates))
    credence = {
        each.effects: each.log_evidence - cost * len(each.effects) for each in found.evidences
    }
    if found.verdict is Verdict.UNKNOWN:
        shape = -np.inf if found.shape.startswith(WIDER_NOISE) else found.unlisted
        return max(shape, *credence.values())
    odd = {each.effects: against(each.left_p_value) for each in found.evidences}
    return max(credence[each] - odd[each] for each in found.reported or ((),))


def _of_records(problem: Problem, seed: int, alarm: float, advance: Callable[..., None]) -> Finding:
    """`find` of records in time: where nothing explains all of them, without those that are unlike
    the others, if that is how the others are explained."""
    found = first = _find(problem, seed, alarm, advance)
    count = problem.groups.size
    if count < FEWEST:
        return first
    unlike: list[Entry] = []
    while found.verdict is Verdict.UNKNOWN and found.unlike is not None:
        unlike.append(found.unlike)
        if are_too_many(len(unlike), count):
            return first
        aside = (*problem.aside, *(drop for each in unlike for drop in each.drops))
        found = _find(replace(problem, aside=aside), seed, alarm)
    if found.verdict is Verdict.UNKNOWN:
        return first
    return replace(found, bookkeeping=(*found.bookkeeping, *unlike))


def _unlike(state: State, singles: Sequence[Tried]) -> Entry | None:
    """The record that is farthest off the likeliest single effect, if it has to be called written
    wrongly. What differs by chance from record to record could be anything, and does not count."""
    known = [each for each in singles if np.asarray(each.fitted.model.weights).size == 1]
    if not known:
        return None
    data, near = state.every, max(known, key=lambda each: each.log_evidence).fitted
    z = data.values - settle(data, near.model, near.u[None]).mean
    size = np.sqrt(np.add.reduceat(z**2, data.starts[:-1]) / np.diff(data.starts))
    worst = int(np.argmax(size))
    first, last = data.starts[[worst, worst + 1]]
    if not could_be_anything(z[first:last], data.values):
        return None
    why = (
        f"this record is unlike the others: it lies {size[worst]:.2g} standard deviations off what "
        f"explains them, and of the others none more than {np.delete(size, worst).max():.2g}"
    )
    return Entry("slip", (int(state.problem.group[data.rows[first]]),), why)


def _find(
    problem: Problem,
    seed: int,
    alarm: float,
    advance: Callable[..., None] = lambda count=1: None,
) -> Finding:
    """`find` with the errors as the problem has them."""
    groups, apart = split(problem, seed)
    data = _sample(problem, groups)
    rng = np.random.default_rng([seed, 2])
    found = fit_baseline(data, problem.baseline)
    baseline = posterior(data, found, found.u.size, rng)
    base = baseline.fitted
    unit = _units(problem, data)
    every = sample(problem, np.concatenate([groups, apart]), unit)
    profiles: list[Profile] = []
    for model in problem.candidates:
        profiles.append(profile(data, base, chosen(every, base, model)))
        advance()
    ways = directions(data, base, profiles)
    first = assess(data, base, ways, rng)
    held = sample(problem, apart, unit)
    judge = Judge(problem, data, held, baseline, seed)
    plain = judge.judge(baseline, Gain()) if apart.size else None
    advance()
    state = State(problem, data, every, base, baseline, profiles, ways, judge, first, rng)
    singles: list[Tried] = []

    def look_at(several: Sequence[Profile]) -> None:
        for each in several:
            singles.append(fit_candidate(data, base, each))
            advance()

    noticed = "" if first.p_value <= alarm else missing_otherwise(state, plain)
    missing = first.p_value <= alarm or bool(noticed)
    # scatter leaves no mean for the tests to see: its likelihood is asked for in any case
    scatters = [np.asarray(each.model.weights).size > 1 for each in profiles]
    if data.first is not data:
        # of many rows the effect's own test tells nearly as much, and at once
        odd = {each.name for each in first.table if each.p_value < SCATTER_ODD}
        scatters = [by and p.name in odd for by, p in zip(scatters, profiles, strict=True)]
    look_at([each for each, chance in zip(profiles, scatters, strict=True) if missing or chance])
    if not missing:
        least = max(baseline.log_evidence, first.unlisted) + SCATTER_GAIN
        missing = any(each.log_evidence > least for each in singles)
        if missing:
            noticed = "it is much likelier that drops differ by chance"
            look_at([each for each, chance in zip(profiles, scatters, strict=True) if not chance])
    if missing:
        least = near_likeliest(singles, baseline.log_evidence)

        def corrected(each: Tried) -> Tried:
            near = each.log_evidence >= least
            return fit_simulated(data, base, each, least) if near else each

        singles = list(in_threads(corrected, singles))
        explained, singles = explain(state, singles)
    else:
        explained = []
        advance(len(profiles) - len(singles))
    reported = named(state, explained)
    best = reported[0] if reported else None
    # what is reported: the likeliest explanation that holds, else the baseline as it is
    final, kept = (best.posterior, best.left) if best else (baseline, first)
    nearest = max(explained, key=lambda each: state.credence(each.posterior), default=None)
    left = nearest.left if nearest and best is None else kept
    if not missing:
        verdict = Verdict.ADEQUATE
    elif best is None:
        verdict = Verdict.UNKNOWN
    else:
        verdict = Verdict.EFFECT if len(reported) == 1 else Verdict.AMBIGUOUS
    tied = [each.posterior for each in reported]
    bare = data.values.size <= base.u.size
    alone = _far_off(problem, data, kept.residual, best.held if best else plain)
    likelier = _likelier(state, best, explained) if best else ""
    rough, like = ROUGH if final.few else "", _like_noise(problem, tied)
    doubts = (alone, likelier, _spared(reported), like, rough, BARE if bare else "")
    advance()
    return Finding(
        problem=problem,
        verdict=verdict,
        weights=_by_effect(state, reported),
        probabilities=probabilities(state, singles, explained),
        reported=tuple(each.effects for each in tied),
        statistic=first.statistic,
        p_value=first.p_value,
        open_set_p_value=left.p_value,
        tests=first.table,
        tests_after=left.table,
        parameters=_parameters(final),
        unidentified=final.fitted.unseen,
        at_bounds=final.fitted.at_bounds,
        classes=tuple(classes(profiles)),
        limits={each.name: each.limits(first.needed.get(each.name, np.inf)) for each in profiles},
        needed_d=first.needed,
        evidences=_evidences(baseline, singles, explained),
        unlisted=first.unlisted,
        shape=first.shape,
        nearest=_near(first, nearest) if nearest else None,
        noise=_noise(data, kept, bare or (missing and best is None)),
        rms_before=rms(first.residual),
        rms_after=rms(kept.residual),
        coverage_90=float(np.mean(np.abs(kept.residual) < 1.645)),
        held_out=best.held if best else plain,
        next_experiment=next_experiment(problem, tied),
        model=final.fitted.model,
        theta=final.fitted.theta,
        rows=data.rows,
        residual_before=first.residual,
        noticed=noticed,
        warnings=(*filter(None, (problem.lead,)), *problem.warnings, *filter(None, doubts)),
        bookkeeping=problem.bookkeeping,
        unlike=_unlike(state, singles) if problem.records and missing and best is None else None,
        remarks=_remarks(tied),
        seed=seed,
        alarm=alarm,
    )


def _far_off(problem: Problem, data: Sample, residual: Array, held: HeldOut | None) -> str:
    """Which groups lie far off where few do, in words; a slip of the pen has no effect's name."""
    if not problem.sigma_declared:
        return ""
    far: dict[int, float] = {}
    for row, size in zip(data.rows, np.abs(residual), strict=True):
        far[int(problem.group[row])] = max(float(size), far.get(int(problem.group[row]), 0.0))
    if held is not None:
        far[held.farthest] = held.greatest
    far = {group: size for group, size in far.items() if size > FAR_OFF}
    if not 0 < len(far) <= FEW:
        return ""
    return "far off: " + ", ".join(f"no. {g} by {size:.2g} sigma" for g, size in far.items())


def _likelier(state: State, best: Explanation, explained: Sequence[Explanation]) -> str:
    """Which explanations are likelier than the one that is named and do not hold, in words."""
    by = [state.credence(each.posterior) - state.standing(best) for each in explained]
    return "; ".join(
        f"{' with '.join(each.posterior.effects)}, {_times(nats)} as probable, was refused: "
        f"{each.why_not}"
        for each, nats in zip(explained, by, strict=True)
        if not each.holds and nats > LIKELIER
    )


def _like_noise(problem: Problem, tied: Sequence[Posterior]) -> str:
    """Whether what is named differs by chance from one value to the next, in words."""
    names = [
        " with ".join(each.effects)
        for each in tied
        if np.asarray(each.fitted.model.weights).size > 1
    ]
    if not names or problem.values.size > np.unique(problem.group).size:
        return ""
    return (
        f"in {problem.main_quantity} alone, errors of measurement that grow with the height look "
        f"exactly like {', '.join(names)}: measure another quantity of each drop as well, which "
        "does not share them"
    )


def _spared(reported: Sequence[Explanation]) -> str:
    """What would have refused effects that are named all the same, in words."""
    spared = [each for each in reported if each.spared]
    said = []
    if few := [each for each in spared if not each.against]:
        names = ", ".join(" with ".join(each.posterior.effects) for each in few)
        held = ", ".join(map(str, few[0].held.groups)) if few[0].held else ""
        said.append(
            f"the held-out data (no. {held} alone) speak against {names}, but they are too few to "
            "refuse an effect: measure more"
        )
    for each in spared:
        if each.against:
            names, left = " with ".join(each.posterior.effects), each.left
            told = f"test for {left.statistic}: {p_text(left.p_value)}"
            said.append(f"what {names} leaves is odd ({told}), but not by enough to refuse it")
    return "; ".join(said)


def _times(nats: float) -> str:
    """How many times as probable, by the difference of logarithms."""
    return f"{math.exp(nats):.2g} times" if nats < MANY else "thousands of times"


def _sample(problem: Problem, groups: Ints) -> Sample:
    """The rows to fit; where sigma is not declared, in units of the scatter that they show."""
    data = sample(problem, groups)
    if problem.sigma_declared:
        return data
    first = fit_baseline(data, problem.baseline)
    baseline = problem.baseline
    everywhere = np.asarray(baseline.weights) @ np.asarray(baseline.predict(first.theta))
    return sample(problem, groups, estimated_units(problem, groups, everywhere))


def _units(problem: Problem, data: Sample) -> Array:
    """The unit of each of the problem's rows, by its quantity."""
    number = np.unique(problem.quantity, return_inverse=True)[1]
    unit = np.ones(number.max() + 1)
    unit[number[data.rows]] = data.unit
    return unit[number]


def _remarks(tied: Sequence[Posterior]) -> dict[tuple[str, ...], Mapping[str, str]]:
    """What parameters do not tell, such as where an effect acts: by reported model, by effect."""
    models = {each.effects: each.fitted.model for each in tied}
    return {k: each.remarks for k, each in models.items() if isinstance(each, Chosen)}


def _by_effect(state: State, reported: Sequence[Explanation]) -> dict[str, float]:
    """Share of an effect in what is reported: of all reported models that have it."""
    out: dict[str, float] = {}
    weights = shares_of([state.standing(each) for each in reported])
    for each, weight in zip(reported, weights, strict=True):
        for name in each.posterior.effects:
            out[name] = out.get(name, 0.0) + float(weight)
    return out


def _parameters(final: Posterior) -> dict[str, Interval]:
    out: dict[str, Interval] = {}
    for i, each in enumerate(final.fitted.model.parameters):
        low, high = final.interval(i)
        name = each.name if each.name not in out else f"{each.name}_{i}"
        out[name] = Interval(final.median(i), low, high, each.unit)
    return out


def _evidences(
    baseline: Posterior, singles: Sequence[Tried], explained: Sequence[Explanation]
) -> tuple[Evidence, ...]:
    """The baseline and every model tried, the likeliest of as many effects first."""
    looked = {each.posterior.effects: each for each in explained}
    pairs = [each.posterior for each in explained if len(each.posterior.effects) > 1]
    models: list[Tried | Posterior] = [*singles, *pairs]
    models.sort(key=lambda each: (len(each.effects), -each.log_evidence))
    out = []
    for each in (baseline, *models):
        found = looked.get(each.effects)
        p_value, why = (found.left.p_value, found.why_not) if found else (None, "")
        theta = tuple(float(x) for x in each.fitted.theta)
        out.append(Evidence(each.effects, each.log_evidence, p_value, why, theta))
    return tuple(out)


def _near(first: Adequacy, best: Explanation) -> Near:
    """How much the likeliest explanation explains of what the baseline leaves beyond its noise."""
    before, after = (
        float(np.sum(residual**2)) - residual.size
        for residual in (first.residual, best.left.residual)
    )
    share = 1.0 - max(after, 0.0) / before if before > 0 else 0.0
    share = float(np.clip(share, 0, 1))
    return Near(best.posterior.effects, share, rms(best.left.residual), best.why_not)


def _noise(data: Sample, left: Adequacy, moot: bool) -> dict[str, float | str]:
    """What the data say of the noise; ``finding`` where that is clearly not what was expected,
    declared or measured beforehand, and is not ``moot``: no misfit that nothing explains, nor
    values that are as few as parameters."""
    grid = data.noises
    out = grid.describe(left.noise)
    if moot:
        return {**out, "finding": ""}
    normal = grid.shape == 0
    plain = np.flatnonzero(normal & (grid.correlation == 0.0))
    this, *others = data.heights_of_noise(left.residual[None], np.array([left.noise, *plain]))[0]
    odd = this > max(others) + CLEARLY
    sentences = []
    size = rms(left.residual)
    if grid.declared and size < FAR_SMALLER:
        sentences.append(f"it is {size:.1g} times as large as the errors that were used")
    elif out["shape"] != "gaussian":
        # errors of two sizes, one a quantity, are no tails
        even = left.residual / np.sqrt(np.maximum(_by_kind(data, left.residual**2), 1e-300))
        logs = data.heights_of_noise(even[None])[0]
        if odd and logs[~normal].max() > logs[normal].max() + CLEARLY:
            sentences.append("its tails are heavier than a normal distribution's")
    elif grid.declared and not 0.8 < float(out["scale"]) < 1.15 and this > others[0] + CLEARLY:
        times = float(out["scale"])
        sentences.append(f"it is {times:.2g} times as large as the errors that were used")
    if out["correlation"] and odd:
        sentences.append("neighbours in order are correlated")
    return {**out, "finding": "; ".join(sentences)}


def _by_kind(data: Sample, values: Array) -> Array:
    """The mean of values (rows,) of each row's quantity."""
    mean = np.bincount(data.kind, values) / np.maximum(np.bincount(data.kind), 1)
    return np.asarray(mean[data.kind])
