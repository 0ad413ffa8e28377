"""What do these data say the model lacks? The loop from a `Problem` to a `Finding`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from . import attribute, openset
from .detect import detect, kept_noises, shared_noise
from .experiment import next_experiment
from .finding import Evidence, Finding, Interval, Test, Verdict
from .fit import Fitted, settle, to_box
from .heldout import judge, split
from .ladder import Ladder, ladder
from .noise import Ints
from .openset import Left
from .posterior import Posterior, posterior
from .problem import Problem
from .sample import Sample, estimated_units, sample

ALARM = 0.03
LEFT_ALARM = 0.02
# A pair must gain more over a single effect than its own parameters cost, since there are so many
# pairs: 2 nats for their number, 2 since a wrong name is worse; over something unlisted, 2 in all.
PAIR_LEFT = 0.05
PAIR_COST = 4.0
UNLISTED_MARGIN = 1.0
# Nats that a full fit may gain over one Newton step, and its noises over the likeliest one.
REACHED = 4.0
# Evidence, in nats, without which an alarm that is not strong is taken for a false one.
LIKELIER = 1.0


@dataclass(frozen=True)
class Answer:
    """Verdict, the models reported, likeliest first, their weights, and what the best leaves."""

    verdict: Verdict
    reported: tuple[Posterior, ...]
    weights: tuple[float, ...]
    left: Left
    tried: tuple[tuple[Posterior, float | None], ...]


def pieces(problem: Problem) -> int:
    """Of how much work `find` tells."""
    return 2 * len(problem.candidates) + 3


def find(
    problem: Problem,
    seed: int = 0,
    alarm: float = ALARM,
    advance: Callable[..., None] = lambda count=1: None,
) -> Finding:
    """Run the loop: hold out, fit, detect, attribute, test what is left, judge.

    ``alarm`` is the rate at which data that lack nothing are said to lack something. The same
    problem, seed and rate give the same finding to the bit. ``advance`` is called as `pieces` get
    done, with their number where it is not one.
    """
    fitted_groups, held_groups = split(problem, seed)
    data = _sample(problem, fitted_groups)
    rng = np.random.default_rng([seed, 2])
    starts = _spread(problem)
    base, shares = settle(data, problem.baseline, starts)
    ladders = []
    for model in problem.candidates:
        ladders.append(ladder(data, base, model))
        advance()
    spread, gain = shared_noise(data, base, ladders)
    advance()
    detection = detect(data, base, spread, ladders, rng, alarm)
    advance()
    baseline = posterior(data, base, base, shares, rng)
    unlisted = baseline.log_evidence + gain
    if detection.p_value > alarm:
        answer = _adequate(data, baseline, rng)
        advance(len(ladders))
    else:
        likely = kept_noises(data, spread)
        singles = []
        for each in ladders:
            singles.append(attribute.candidate(data, base, each, likely, rng))
            advance()
        known = Known(problem, data, base, baseline, ladders, singles, unlisted, rng)
        answer = _explain(known, detection.p_value, alarm)
    final = answer.reported[0] if answer.reported else baseline
    unit = np.ones(problem.values.size)
    unit[:] = _units(problem, data)
    held = None
    if held_groups.size:
        apart = sample(problem, held_groups, unit)
        held = judge(problem, data, baseline, final, apart, rng)
    tied = answer.reported if answer.verdict is Verdict.AMBIGUOUS else ()
    finding = Finding(
        verdict=answer.verdict,
        effects=_names(answer),
        weights=_weights(answer),
        together=tuple(x.fitted.effects for x in answer.reported if len(x.fitted.effects) > 1),
        statistic=detection.statistic,
        p_value=detection.p_value,
        open_set_p_value=answer.left.p_value,
        tests=tuple(Test(*each) for each in detection.table),
        tests_after=tuple(Test(*each) for each in answer.left.table),
        parameters=_parameters(final),
        unidentified=final.fitted.unseen,
        classes=tuple(attribute.classes(data, base, ladders)),
        detectable=detection.detectable,
        needed_d=detection.needed_d,
        evidences=_evidences(answer, baseline),
        log_evidence_unlisted=unlisted,
        noise=data.noises.describe(final.fitted.noise),
        held_out=held,
        next_experiment=next_experiment(problem, tied),
        model_effects=final.fitted.effects,
        theta=final.fitted.theta,
        rows=data.rows,
        residual_before=detection.residual,
        residual_after=data.values - final.fitted.mean,
        covariates=data.covariates,
        seed=seed,
        alarm=alarm,
    )
    advance()
    return finding


def _sample(problem: Problem, groups: Ints) -> Sample:
    """The rows to fit; where sigma is not declared, in units of the scatter that they show."""
    data = sample(problem, groups)
    if problem.sigma_declared:
        return data
    first, _ = settle(data, problem.baseline, _spread(problem))
    everywhere = np.asarray(problem.baseline.weights) @ np.asarray(
        problem.baseline.predict(first.theta)
    )
    return sample(problem, groups, estimated_units(problem, groups, everywhere))


def _units(problem: Problem, data: Sample) -> np.ndarray:
    """The unit of each of the problem's rows, by its quantity."""
    unit = np.ones(problem.values.size)
    for row, value in zip(data.rows, data.unit, strict=True):
        unit[problem.quantity == problem.quantity[row]] = value
    return unit


def _spread(problem: Problem) -> np.ndarray:
    """Starts (starts, p) for the baseline: its typical values, and corners drawn inward."""
    several = problem.baseline.parameters
    usual = np.array([to_box(each, each.typical) for each in several])
    return np.stack([usual, np.full(usual.size, 0.25), np.full(usual.size, 0.75)])


def _adequate(
    data: Sample,
    baseline: Posterior,
    rng: np.random.Generator,
    tried: tuple[tuple[Posterior, float | None], ...] = (),
) -> Answer:
    left = openset.left_over(data, baseline, baseline.fitted, [], rng)
    return Answer(Verdict.ADEQUATE, (), (), left, tried)


@dataclass(frozen=True)
class Known:
    """What has been worked out before the verdict."""

    problem: Problem
    data: Sample
    base: Fitted
    baseline: Posterior
    ladders: Sequence[Ladder]
    singles: Sequence[Posterior]
    unlisted: float
    rng: np.random.Generator


def _explain(known: Known, p_value: float, alarm: float) -> Answer:
    """Single effects first; pairs where they explain more; unknown where no name holds.

    A weak alarm for which neither an effect nor anything unlisted is likelier than the baseline
    by `LIKELIER` is a false one. Something unlisted that is likelier than the best effect refuses
    the effect.
    """
    data, base, ladders, rng = known.data, known.base, known.ladders, known.rng
    singles = known.singles
    best = max((each.log_evidence for each in singles), default=-np.inf)
    likelier = max(best, known.unlisted) - known.baseline.log_evidence
    if likelier < LIKELIER and p_value > alarm / 6:
        return _adequate(data, known.baseline, rng, tuple((each, None) for each in singles))
    if not singles:
        left = openset.left_over(data, known.baseline, base, [], rng)
        return Answer(Verdict.UNKNOWN, (), (), left, ())
    weights = attribute.weights(singles)
    chosen = attribute.credible(weights)
    tests: dict[int, Left] = {
        i: openset.left_over(data, singles[i], base, ladders, rng) for i in chosen
    }
    tried = tuple(
        (each, tests[i].p_value if i in tests else None) for i, each in enumerate(singles)
    )
    passing = [i for i in chosen if tests[i].p_value > LEFT_ALARM]
    if known.unlisted > best + UNLISTED_MARGIN:
        passing = []
    pairs = _pairs(known, best, bool(passing))
    if pairs is not None:
        verdict = Verdict.EFFECT if len(pairs.reported) == 1 else Verdict.AMBIGUOUS
        return Answer(verdict, pairs.reported, pairs.weights, pairs.left, tried + pairs.tried)
    if passing:
        total = weights[passing].sum()
        return Answer(
            Verdict.EFFECT if len(passing) == 1 else Verdict.AMBIGUOUS,
            tuple(singles[i] for i in passing),
            tuple(float(weights[i] / total) for i in passing),
            tests[passing[0]],
            tried,
        )
    return Answer(Verdict.UNKNOWN, (), (), tests[chosen[0]], tried)


def _pairs(known: Known, best: float, one_suffices: bool) -> Answer | None:
    """Pairs that leave nothing, explain more than one effect and more than anything unlisted."""
    data, base, singles = known.data, known.base, known.singles
    needed = max(best, known.unlisted - PAIR_COST / 2) + PAIR_COST
    plain = known.baseline.fitted
    own_cost = plain.log_likelihood + data.noises.prior[plain.noise] - known.baseline.log_evidence
    wanted = needed + own_cost - REACHED
    names = openset.likely_pairs(
        known.problem, data, base, known.ladders, singles, one_suffices, wanted
    )
    if not names:
        return None
    several = (data, base, known.rng)
    both = [openset.pair(known.problem, several, each, singles, known.ladders) for each in names]
    weights = attribute.weights(both)
    kept: list[tuple[int, Left]] = []
    for i in attribute.credible(weights):
        if both[i].log_evidence > needed:
            left = openset.left_over(data, both[i], base, known.ladders, known.rng)
            if left.p_value > PAIR_LEFT:
                kept.append((i, left))
    if not kept:
        return None
    total = sum(float(weights[i]) for i, _ in kept)
    found = {i: left.p_value for i, left in kept}
    return Answer(
        Verdict.EFFECT,
        tuple(both[i] for i, _ in kept),
        tuple(float(weights[i]) / total for i, _ in kept),
        kept[0][1],
        tuple((each, found.get(i)) for i, each in enumerate(both)),
    )


def _names(answer: Answer) -> tuple[str, ...]:
    return tuple(dict.fromkeys(n for each in answer.reported for n in each.fitted.effects))


def _weights(answer: Answer) -> dict[str, float]:
    """Probability that an effect is there: of all reported models that have it."""
    out: dict[str, float] = dict.fromkeys(_names(answer), 0.0)
    for each, weight in zip(answer.reported, answer.weights, strict=True):
        for name in each.fitted.effects:
            out[name] += weight
    return out


def _parameters(final: Posterior) -> dict[str, Interval]:
    out: dict[str, Interval] = {}
    for i, each in enumerate(final.fitted.model.parameters):
        low, high = final.interval(i)
        name = each.name if each.name not in out else f"{each.name}_{i}"
        out[name] = Interval(float(final.fitted.theta[i]), low, high, each.unit)
    return out


def _evidences(answer: Answer, baseline: Posterior) -> tuple[Evidence, ...]:
    """The baseline and every model tried; weights among those with as many effects."""
    models = [(baseline, None), *answer.tried]
    out = []
    for each, left in models:
        same = [x for x, _ in models if len(x.fitted.effects) == len(each.fitted.effects)]
        top = max(x.log_evidence for x in same)
        mass = sum(np.exp(x.log_evidence - top) for x in same)
        out.append(
            Evidence(
                each.fitted.effects,
                each.log_evidence,
                float(np.exp(each.log_evidence - top) / mass),
                each.d,
                left,
                tuple(float(x) for x in each.fitted.theta),
            )
        )
    return tuple(out)
