"""What y1/y0 = 0.65 ± 0.21 is made of: the loop on sets of drops with the published summaries.

That something is missing needs no set: no model of a bristle under which all drops of a height are
alike scatters more than its instruments do. What it is, only a loop over drops can say.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np
from scipy.stats import chi2

from ...solver import paper
from ...solver.arrays import Array
from ..calibrate.figures import cloud_figure
from ..close_loop.rows import title_of
from ..close_loop.run import Closed
from ..data.datasets import Drops, Manifest
from ..loop.finding import Finding
from ..loop.kinds.drops.problem import drops_problem
from ..loop.problem import Problem
from ..report.figures import picture
from ..report.page import Column, Figure, Section, Table, Value, percent, show
from .campaign import Results
from .loop_study import LoopStudy, estimate_table, verdict_table
from .published_drops import Film, dataset, draw, planned_heights_m

SETS, SEED = 5, 26
# Of these so many are also told the paper's damping, which needs tables of its own.
DECLARED = 2
# The published standard deviation is rounded to two decimals; the least that it stands for.
LEAST_STD = paper.RATIO_STD - 0.005
ALL_LOW_M = np.full(paper.N_DROPS, min(paper.HEIGHTS_M))


def film_scatter(film: Film, y0_m: Array) -> float:
    """Standard deviation of y1/y0 that the film alone makes, were drops from ``y0_m`` (n,) alike:
    to first order in what each height is read wrong by."""
    both = film.sigma_m**2 + (film.reading_m * paper.RATIO_MEAN) ** 2
    return float(np.sqrt(both * np.mean(y0_m**-2.0)))


def chance_of_scatter(expected: float) -> float:
    """How often 26 drops that scatter by ``expected`` show the published scatter or more."""
    free = paper.N_DROPS - 1
    return float(chi2.sf(free * (LEAST_STD / expected) ** 2, free))


def needed_mm() -> float:
    """The error of reading, in mm, that would make the published scatter by itself."""
    square = LEAST_STD**2 / np.mean(planned_heights_m() ** -2.0) - Film().spread_low_m ** 2
    return float(1e3 * np.sqrt(square / (1.0 + paper.RATIO_MEAN**2)))


class LoopOnPaper(LoopStudy):
    """The section of `bristle reproduce`: the loop on so many ``sets``, each as a ``problem``, with
    the damping unknown, and the first `DECLARED` again with the paper's."""

    def __init__(
        self, sets: int = SETS, problem: Callable[[Drops], Problem] = drops_problem
    ) -> None:
        self.sets, self.problem = sets, problem

    def drawn(self) -> list[tuple[Array, Array]]:
        """The sets: heights before and after, as read."""
        return [draw(np.random.default_rng([SEED, i])) for i in range(self.sets)]

    def datasets(self) -> list[tuple[Manifest, Callable[[], Problem]]]:
        drawn = self.drawn()
        made = [
            dataset(f"set {number}, damping {known}", *each, damping=damping)
            for damping, known, sets in (
                (False, "unknown", drawn),
                (True, "the paper's", drawn[:DECLARED]),
            )
            for number, each in enumerate(sets, 1)
        ]
        return [(each.manifest, partial(self.problem, each)) for each in made]

    def section(self, results: Results) -> Section:
        """The section with its sentences, tables and the sets."""
        del results
        drawn = self.drawn()
        answer, *further = told(self.closed[: self.sets])
        with_beta, *_ = told(self.closed[self.sets :])
        words = [
            f"With the damping unknown, {answer}",
            *further,
            f"With the paper's β = {paper.BETA_S:g} s declared, {with_beta}",
        ]
        return Section(
            "loop",
            "What the 65 % is made of",
            [*_introduction(drawn), *words],
            figures=[_drops(drawn)],
            tables=[
                verdict_table("loop_sets", "The loop on each set.", self.closed),
                estimate_table("loop_estimates", self.closed),
            ],
            headline=f"What the 65 % is made of: {words[0]}",
        )


def _introduction(drawn: Sequence[tuple[Array, Array]]) -> list[str]:
    film = Film()
    low, high = (_scatter_from(drawn, paper.HEIGHTS_M[i]) for i in (0, -1))
    worst = Film(reading_m=1e-3)
    p = chance_of_scatter(film_scatter(worst, ALL_LOW_M))
    return [
        "Is something missing? Yes, by the summaries alone. One Kn gives all drops of a height "
        f"the same y1/y0, and a film adds little: {paper.N_DROPS} drops scatter by "
        f"{paper.RATIO_STD:.2f} (1 standard deviation), of which a film read to "
        f"{1e3 * film.reading_m:g} mm makes {show(film_scatter(film, planned_heights_m()), 2)}. "
        "Had every one been made from 10 mm and read to 1 mm, as much would come by chance with "
        f"p = {show(p, 2)}. Spread over the five heights, they would have to be read wrong by "
        f"{show(needed_mm(), 2)} mm.",
        "What is it? That takes drops, and the paper published none but one, "
        f"{1e3 * paper.KNOWN_DROP_M[0]:.1f} to {1e3 * paper.KNOWN_DROP_M[1]:.0f} mm. So "
        f"{len(drawn)} sets of {paper.N_DROPS} are drawn, at random but for that drop and for "
        f"what is published: mean {paper.RATIO_MEAN:.2f} and standard deviation "
        f"{paper.RATIO_STD:.2f} of y1/y0, slope {paper.RATIO_MEAN:.2f}, R² {paper.R2_LINEAR:.4f} "
        f"of the line and {paper.R2_QUADRATIC:.4f} of the quadratic, to their last printed digit. "
        "None of the other drops was measured. Not published are how many were made from which "
        "height, in which order, and how y1/y0 is distributed: heights are spread evenly, the "
        "order is random, the distribution is a beta. What the loop finds is a finding on the "
        "paper's drops only where it holds over the sets.",
        f"In the sets y1/y0 scatters by {show(low, 2)} from {1e3 * paper.HEIGHTS_M[0]:.0f} mm and "
        f"by {show(high, 2)} from {1e3 * paper.HEIGHTS_M[-1]:.0f} mm: with heights spread evenly "
        "that is how the published R² goes with the published standard deviation. Had more drops "
        "been made from the lowest and highest, it could be the same from every height.",
        f"At {paper.FRAMES_PER_S:g} frames/s the nearest frame shows an apex too low by g dt²/2: "
        f"{1e3 * film.mean_low_m:.2f} mm on the average, which is added to y1, with a standard "
        f"deviation of {1e3 * film.spread_low_m:.2f} mm. With readings to "
        f"{1e3 * film.reading_m:g} mm, an assumption, that makes {1e3 * film.sigma_m:.2f} mm, the "
        "declared uncertainty of every height; y0, before the release, is known better than that. "
        "Declared are the bristle's dimensions and steel's constants; Kn, friction and damping "
        "are unknown.",
    ]


def _scatter_from(drawn: Sequence[tuple[Array, Array]], height_m: float) -> float:
    """Standard deviation of y1/y0 of the drops from one height, over the sets."""
    return float(np.sqrt(np.mean([np.var((y1 / y0)[y0 == height_m], ddof=1) for y0, y1 in drawn])))


def told(sets: Sequence[Closed]) -> list[str]:
    """What holds over the sets, in words; the first paragraph is the answer."""
    n, findings = len(sets), [each.finding for each in sets]
    verdicts = _counted(str(each.verdict) for each in findings)
    sentence = f"over {n} sets with the published summaries the loop's verdict is {verdicts}."
    pooled = _pooled(findings)
    if pooled:
        sentence += " Named, with the probability averaged over the sets: " + "; ".join(
            f"{title_of(name)} {np.mean(w):.2f} ({min(w):.2f} to {max(w):.2f})"
            for name, w in pooled.items()
        )
        always = [title_of(name) for name, w in pooled.items() if min(w) > 0.0]
        sentence += f". Named in every set: {' and '.join(always) or 'none'}."
        by_chance = sum(_differs_by_chance(each) for each in sets)
        sentence += (
            f" In {by_chance} of {n} sets the likeliest is something that differs from drop to "
            "drop by chance."
        )
    errors = _errors(findings)
    if any(map(_differs_by_chance, sets)):
        errors += (
            " What differs by chance cannot be predicted drop by drop: it widens the interval and "
            "leaves the error."
        )
    return [f"{sentence}{_reach(findings)}", errors, _further(findings)]


def _counted(words: Iterable[str]) -> str:
    return ", ".join(f"{word} in {count}" for word, count in Counter(words).most_common())


def _pooled(findings: Sequence[Finding]) -> dict[str, list[float]]:
    """Probabilities of each named effect, set by set, the likeliest on the average first."""
    names = dict.fromkeys(name for each in findings for name in each.effects)
    found = {name: [float(each.weights.get(name, 0.0)) for each in findings] for name in names}
    return dict(sorted(found.items(), key=lambda each: -sum(each[1])))


def _differs_by_chance(closed: Closed) -> bool:
    return np.size(closed.finding.model.weights) > 1


def _reach(findings: Sequence[Finding]) -> str:
    """How far the intervals of parameters that all sets have reach together."""
    sentences = []
    for name, one in findings[0].parameters.items():
        every = [each.parameters[name] for each in findings if name in each.parameters]
        if len(every) == len(findings):
            low, high = min(x.low for x in every), max(x.high for x in every)
            sentences.append(f"{name} {show(low, 2)} to {show(high, 2)} {one.unit}".rstrip())
    return f" Over the sets the 90 % intervals span: {'; '.join(sentences)}." if sentences else ""


def _errors(findings: Sequence[Finding]) -> str:
    held = [each.held_out for each in findings if each.held_out is not None]
    if not held:
        return "There were too few drops to hold any out."
    before, after, noise, within = np.mean(
        [(x.rms_before, x.rms_after, x.sigma, x.coverage_90) for x in held], axis=0
    )
    return (
        f"Error on drops held out, mean over the sets: {show(before, 3)} {held[0].unit} before, "
        f"{show(after, 3)} after; what is found allows for {show(noise, 3)}, and "
        f"{percent(within, 0)} of the drops lie within their 90 % intervals."
    )


def _further(findings: Sequence[Finding]) -> str:
    noise = _counted(str(each.noise["finding"]) for each in findings if each.noise["finding"])
    tied = [each.next_experiment for each in findings if each.next_experiment is not None]
    sentence = f"Of the noise the drops say other than declared: {noise or 'nothing, in any set'}."
    if not tied:
        return (
            f"{sentence} No set leaves several effects tied, so that none asks for a measurement."
        )
    return f"{sentence} What would decide between those tied: {_counted(x.change for x in tied)}."


def _drops(drawn: Sequence[tuple[Array, Array]]) -> Figure:
    y0, y1 = (np.concatenate(each) for each in zip(*drawn, strict=True))
    rows: list[tuple[Value, ...]] = [
        (number, drop, 1e3 * float(a), 1e3 * float(b))
        for number, each in enumerate(drawn, 1)
        for drop, (a, b) in enumerate(zip(*each, strict=True), 1)
    ]
    head = (
        Column("set", "set"),
        Column("drop", "drop"),
        Column("y0_mm", "y0", "mm"),
        Column("y1_mm", "y1", "mm"),
    )
    return Figure(
        "published-sets",
        "The drops of all sets, as read, beside what is published: line 65 %, band 30 % to "
        "100 %, and the one drop. None of the others was measured.",
        picture(cloud_figure(y0, y1, "drawn here, not measured")),
        "Height after against before, of the drawn sets",
        Table("published_sets", "The drawn drops, in the order made.", head, rows),
    )
