"""Which models explain the data: tested on what they leave, and scored on held-out data.

An effect explains them that the likelihood asks for, that leaves noise by the tests that the
baseline did not pass (`adequacy`), and that pays on data that it was not fitted to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax
from scipy.stats import norm

from ...solver.arrays import Array
from .adequacy import OCCAM, Adequacy, Direction, assess, outliers_together
from .finding import p_text
from .fit import Fitted, settle
from .heldout import LEAST_SCORED, HeldOut, Judge, Scores, trimmed_rms
from .posterior import Posterior, posterior
from .problem import Problem
from .profile import Profile
from .sample import Sample
from .search import Tried, fit_pairs, fit_refined

LEFT_ALARM = 0.01
CREDIBLE = 0.97
LOOKED_AT, MOST_LOOKED_AT = 0.999, 8
# What is so many nats less likely than the likeliest is beyond its credible set.
NEAR = -math.log(1.0 - CREDIBLE)
# An effect is refined that explains this share of what the likeliest does.
REFINED = 0.2
# Nats by which something unlisted must be likelier than an effect to refuse it. What scatters has
# to be as likely, since wider noise is always near.
UNLISTED_MARGIN = 3.0
# By which share a right effect may still be off: by its law, by tables, by a beam for a solid. What
# is off by a share of d takes the square of that share from the d²/2 nats that it gains. Of a pair
# the second effect would live on what the first is off by, so a pair is given none of that.
LAW_OFF = 0.1
# Residuals of so many rows that are beyond this over the declared noise are none.
MOST_RATIO, LEAST_ROWS = 1.5, 8
# Held-out errors of a smaller chance are no noise.
SURPRISE = 0.003
# Declared standard deviations by which no noise is off, its outliers included: those of a
# contaminated normal distribution have up to ten times its sigma, and a thousandth of them is three
# times as far off.
GROSS = 30.0


@dataclass(frozen=True)
class Explanation:
    """A model with effects, what it leaves, and what it gains on held-out data, with its
    ``scores``. Both are None where there are no such data, or the model is refused for what it
    leaves.

    It ``holds`` where what it leaves is noise and it pays as well. It is ``spared`` where only the
    scores of too few held-out groups speak against it, or only its residuals. Residuals that are
    odd count ``against`` it by so many nats.
    """

    posterior: Posterior
    left: Adequacy
    held: HeldOut | None
    scores: Scores | None
    holds: bool
    why_not: str
    spared: bool
    against: float


@dataclass(frozen=True)
class State:
    """What has been worked out before the verdict."""

    problem: Problem
    data: Sample
    every: Sample
    base: Fitted
    baseline: Posterior
    profiles: Sequence[Profile]
    ways: list[Direction]
    judge: Judge
    first: Adequacy
    rng: np.random.Generator

    @property
    def cost(self) -> float:
        """What every effect costs in nats."""
        return effect_cost(len(self.profiles))

    def margin(self, found: Posterior) -> float:
        """Nats by which something unlisted must be likelier than a model to refuse it."""
        if _scatters(found):
            return 0.0
        gained = found.log_evidence - self.baseline.log_evidence
        alone = len(found.effects) == 1
        return max(UNLISTED_MARGIN, LAW_OFF**2 * gained) if alone else UNLISTED_MARGIN

    def credence(self, found: Posterior) -> float:
        """Log evidence with the prior on the number of effects, over no effect's."""
        gained = found.log_evidence - self.baseline.log_evidence
        return gained - self.cost * len(found.effects)

    def standing(self, each: Explanation) -> float:
        """The credence of an explanation, less what its residuals count against it."""
        return self.credence(each.posterior) - each.against


def effect_cost(candidates: int) -> float:
    """What every effect costs in nats. Beforehand, one of the ``candidates`` is expected to be
    there; all are equally likely, and independent of each other."""
    return math.log(max(candidates - 1, 1))


def explain(state: State, singles: list[Tried]) -> tuple[list[Explanation], list[Tried]]:
    """The likeliest single effects, refined where none of them holds, and the pairs that are
    likelier than all of these; and the single effects, as refined as they are."""
    if not singles:
        return [], singles
    looked, refined = _looked_at(state, singles), singles
    plain = state.baseline.log_evidence
    if not any(each.holds for each in looked):
        least = plain + REFINED * (max(each.log_evidence for each in singles) - plain)
        refined = [
            fit_refined(state.data, state.base, each) if each.log_evidence >= least else each
            for each in singles
        ]
        if any(one is not other for one, other in zip(refined, singles, strict=True)):
            looked = _looked_at(state, refined)
    # a pair has to be likelier than the effects that hold by themselves
    alone = [each.posterior.log_evidence for each in looked if each.holds]
    least = max(alone, default=max(each.log_evidence for each in refined) - NEAR) + state.cost
    data, every, base = state.data, state.every, state.base
    pairs = fit_pairs(state.problem, data, every, base, singles, state.profiles, plain, least)
    better = [each for each in pairs if each.log_evidence > least]
    explained = [*looked, *_looked_at(state, better, refined, looked)]
    return _with_spared(state, explained, refined), refined


def _with_spared(
    state: State, explained: list[Explanation], parts: Sequence[Tried]
) -> list[Explanation]:
    """The same. If one holds, others hold beside it: those that were spared, and those that only
    their residuals speak against, unless they are far less likely than the likeliest. A pair among
    these has to be likelier than each single effect that holds. ``parts`` are the single effects.
    """
    if not any(each.holds for each in explained):
        return explained
    least = max(state.standing(each) for each in explained if each.holds or each.spared)
    least -= UNLISTED_MARGIN
    scored = _scores_of(explained)
    out = []
    for each in explained:
        if not each.holds and not each.spared and state.standing(each) > least:
            each = _but_for_residuals(state, each, parts, scored)
        kept = each.spared and state.standing(each) > least
        out.append(replace(each, holds=True, why_not="") if kept else each)
    singles = [state.standing(e) for e in out if e.holds and len(e.posterior.effects) == 1]
    enough = max(singles, default=-np.inf)
    return [
        before
        if each.spared and len(each.posterior.effects) > 1 and state.standing(each) < enough
        else each
        for before, each in zip(explained, out, strict=True)
    ]


def _but_for_residuals(
    state: State, each: Explanation, parts: Sequence[Tried], scored: dict[tuple[str, ...], Scores]
) -> Explanation:
    """An explanation that is spared if only what it leaves speaks against it; else as it was."""
    found = each.posterior
    if not each.against or _too_large(state, found, each.left):
        return each
    why, held, scores, _ = _judged(state, found, parts, scored)
    return each if why else replace(each, held=held, scores=scores, spared=True)


def named(state: State, explained: Sequence[Explanation]) -> list[Explanation]:
    """The credible set of what holds for itself, and all that holds beside it; likeliest first."""
    alone = [each for each in explained if each.holds and not each.spared]
    shares = shares_of([state.standing(each) for each in alone])
    beside = [each for each in explained if each.holds and each.spared]
    out = [*(alone[i] for i in credible(shares, CREDIBLE)), *beside]
    return sorted(out, key=lambda each: -state.standing(each))


def _looked_at(
    state: State,
    tried: Sequence[Tried],
    parts: Sequence[Tried] = (),
    known: Sequence[Explanation] = (),
) -> list[Explanation]:
    """Tests and held-out scores of the likeliest models, over the baseline and, of pairs, over the
    likelier of their ``parts``, some of which are ``known``."""
    shares = shares_of([each.log_evidence for each in tried])
    scored = _scores_of(known)
    out = []
    for i in credible(shares, LOOKED_AT)[:MOST_LOOKED_AT] if tried else ():
        found = _sampled(state, tried[i])
        others = [way for way in state.ways if way.name not in found.effects]
        assessed = assess(state.data, found.fitted, others, state.rng, unlisted=False)
        why, held, scores, spared = _unfit(state, found, assessed), None, None, False
        if not why:
            why, held, scores, spared = _judged(state, found, parts, scored)
        odd = against(assessed.p_value)
        out.append(Explanation(found, assessed, held, scores, not why, why, spared, odd))
    return out


def _scores_of(known: Sequence[Explanation]) -> dict[tuple[str, ...], Scores]:
    return {each.posterior.effects: each.scores for each in known if each.scores is not None}


def _judged(
    state: State,
    found: Posterior,
    parts: Sequence[Tried],
    scored: dict[tuple[str, ...], Scores],
) -> tuple[str, HeldOut | None, Scores | None, bool]:
    """Why held-out data refuse a model, in words, empty where they do not; its errors on them; its
    scores; and whether only the scores of too few speak against it."""
    if not state.judge.held.values.size:
        return "", None, None, False
    scores = state.judge.scores(found)
    held = state.judge.judge(found, state.judge.gain(scores, state.judge.plain))
    own = [p for p in parts if len(found.effects) > 1 and p.effects[0] in found.effects]
    part = max(own, key=lambda each: each.log_evidence, default=None)
    if part is not None and part.effects not in scored:
        scored[part.effects] = state.judge.scores(_sampled(state, part))
    over = scored[part.effects].logs.sum() if part else -np.inf
    worse = _worse(found, held, scores.logs.sum() - over)
    few = len(held.groups) < LEAST_SCORED
    off = _off(state, found, held) if few or not worse else ""
    return off or worse, held, scores, bool(worse) and few and not off


def _sampled(state: State, tried: Tried) -> Posterior:
    return posterior(state.data, tried.fitted, state.base.u.size, state.rng)


def _unfit(state: State, found: Posterior, left: Adequacy) -> str:
    """Why what a model leaves is not noise, in words; empty where it is."""
    if left.p_value <= LEFT_ALARM:
        told = f"test for {left.statistic}: {p_text(left.p_value)}"
        return f"what it leaves is not noise ({told})"
    return _too_large(state, found, left)


def _too_large(state: State, found: Posterior, left: Adequacy) -> str:
    """Why what a model leaves is too large, or too much of one shape, in words; empty where it is
    not."""
    if _large(state.data, left.residual):
        return "what it leaves is larger than the declared noise"
    cost = state.cost * (len(found.effects) - 1)
    if state.first.unlisted > found.log_evidence - cost + state.margin(found):
        return f"a shape that no effect has explains more ({state.first.shape})"
    return ""


def against(left: float | None) -> float:
    """Nats that a model's residuals count against it, by their p-value ``left``; zero where that
    does not refuse the model."""
    return 0.0 if left is None or left > LEFT_ALARM else odds_against(left)


def odds_against(p_value: float) -> float:
    """The nats that a p-value can count at most against the hypothesis that it tests (T. Sellke,
    M. J. Bayarri and J. O. Berger, Am. Stat. 55 (2001) 62)."""
    p = max(p_value, 1e-300)
    return max(-1.0 - math.log(-p * math.log(p)), 0.0) if p < 1.0 / math.e else 0.0


def _worse(found: Posterior, held: HeldOut, over: float) -> str:
    """Why a model does not pay on held-out data, in words; empty where it does. ``over`` is what a
    pair's log score gains over that of the likelier of its parts."""
    if held.gain.low <= 0.0:
        return "the log score of held-out data does not rise"
    if over <= 0.0:
        return "held-out data are predicted no better than with one effect alone"
    if not _scatters(found) and not held.gain.nearer:
        return "the error on held-out data does not fall"
    return ""


def _scatters(found: Posterior) -> bool:
    """Whether a model differs by chance from group to group."""
    return np.asarray(found.fitted.model.weights).size > 1


def missing_otherwise(state: State, plain: HeldOut | None) -> str:
    """By what else than the tests of residuals something is seen to be missing, in words; empty
    where by nothing."""
    if _large(state.data, state.first.residual):
        return "residuals are larger than the declared noise"
    return "" if plain is None else _off(state, state.baseline, plain)


def _off(state: State, found: Posterior, held: HeldOut) -> str:
    """What held-out data are of a model that noise is not, in words; empty where nothing: also when
    it is fitted to them as well, since three outliers of which two are held out may be a band."""
    if held.surprise < SURPRISE or held.greatest > GROSS:
        return "held-out data lie farther off than their noise allows"
    fitted = settle(state.every, found.fitted.model, found.fitted.u[None])
    left = assess(state.every, fitted, [], state.rng, unlisted=False)
    if left.p_value < SURPRISE:
        return f"with the held-out data, what is left is not noise (test for {left.statistic})"
    if outliers_together(state.every, left.residual, state.rng) < LEFT_ALARM:
        return "outliers lie side by side, and so are not noise"
    return ""


def _large(data: Sample, residual: Array) -> bool:
    """Whether a quantity's residuals (rows,) are more than any noise may be, outliers aside, or one
    is more than any outlier."""
    if not data.noises.declared:
        return False
    sizes = [residual[data.kind == kind] for kind in np.unique(data.kind)]
    return np.abs(residual).max(initial=0.0) > GROSS or any(
        z.size >= LEAST_ROWS and trimmed_rms(z) > MOST_RATIO for z in sizes
    )


def probabilities(
    state: State, singles: Sequence[Tried], explained: Sequence[Explanation]
) -> dict[str, float]:
    """How likely each effect is to be in the data, by what `explain` found; where that is nothing,
    since nothing is missing, by what each would gain on the baseline.

    Among none, one and two effects, and a shape that no effect has, which is as likely beforehand
    as it has to be to refuse an effect. What was refused is out. Empty where nothing is left.
    """
    plain = state.baseline.log_evidence
    holding = [each for each in explained if each.holds]
    margin = max([UNLISTED_MARGIN, *(state.margin(each.posterior) for each in holding)])
    logs = {(): 0.0, ("?",): state.first.unlisted - plain - state.cost - margin}
    if explained:
        if not holding:
            return {}
        logs |= {each.posterior.effects: state.standing(each) for each in holding}
    else:
        # the square of a normal number that has the p-value of the effect's own test
        for each in state.first.table:
            if any(each.name == way.name for way in state.profiles):
                gain = 0.5 * max(float(norm.isf(each.p_value)), 0.0) ** 2
                logs[each.name,] = gain - OCCAM - state.cost
        logs |= {each.effects: each.log_evidence - plain - state.cost for each in singles}
    out: dict[str, float] = {}
    for effects, share in zip(logs, shares_of(list(logs.values())), strict=True):
        for name in effects:
            out[name] = out.get(name, 0.0) + float(share)
    out.pop("?")
    return dict(sorted(out.items(), key=lambda each: -each[1]))


def shares_of(logs: Sequence[float]) -> Array:
    """Probabilities (models,) from log evidences, with equal priors."""
    return np.asarray(softmax(logs)) if len(logs) else np.zeros(0)


def credible(shares: Array, level: float) -> list[int]:
    """The smallest set of models with at least this probability, likeliest first."""
    order = np.argsort(-shares, kind="stable")
    enough = int(np.searchsorted(np.cumsum(shares[order]), level - 1e-12)) + 1
    return [int(i) for i in order[:enough]]
