"""How far each program is from the converged value, and how long it takes to come near."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from .programs import QUANTITIES, Answer, Setting

LEVELS = (1e-2, 1e-3)
Found = dict[str, float]


@dataclass(frozen=True)
class Run:
    """One call of a program."""

    program: str
    setting: Setting
    answer: Answer


@dataclass(frozen=True)
class Converged:
    """What a drop tends to: values, and how far they may be off (relative), by quantity.

    ``rod`` is what the exact rod has; empty where it could not be asked.
    """

    values: Found
    unsure: Found
    rod: Found


@dataclass(frozen=True)
class Point:
    """A program at one setting: errors relative to the converged value, medians of its costs."""

    program: str
    setting: Setting
    found: Found
    errors: Found
    wall_s: float
    wall_low_s: float
    wall_high_s: float
    further_s: float | None
    peak_rss_MB: float
    repeats: int


@dataclass(frozen=True)
class Reached:
    """The time to an error of ``level`` in y1/y0; None where no setting came so near.

    ``coarsest`` says that the longest ITS was near enough already, so that less may do.
    """

    level: float
    time_s: float | None
    coarsest: bool = False


def converged(coarse: Found, fine: Found, rod: Found) -> Converged:
    """Richardson's value from an ITS and half of it, at second order.

    It is as sure as the exact rod agrees, which has no lateral inertia, or, without that, as far
    as the finer value is away.
    """
    values = {name: fine[name] + (fine[name] - coarse[name]) / 3.0 for name in QUANTITIES}
    near = rod or fine
    unsure = {name: abs(near[name] / values[name] - 1.0) for name in QUANTITIES}
    return Converged(values, unsure, rod)


def points(runs: Sequence[Run], to: dict[str, Converged]) -> list[Point]:
    """One point for each program and setting that answered, in the order of the runs."""
    groups: dict[tuple[str, Setting], list[Answer]] = {}
    for run in runs:
        if not run.answer.why_not:
            groups.setdefault((run.program, run.setting), []).append(run.answer)
    return [
        _point(name, setting, each, to[setting.physics.name])
        for (name, setting), each in groups.items()
    ]


def _point(name: str, setting: Setting, answers: list[Answer], to: Converged) -> Point:
    found = answers[0].found
    walls = [each.wall_s for each in answers]
    further = [each.further_s for each in answers if each.further_s is not None]
    return Point(
        program=name,
        setting=setting,
        found=found,
        errors={key: abs(found[key] / to.values[key] - 1.0) for key in QUANTITIES},
        wall_s=statistics.median(walls),
        wall_low_s=min(walls),
        wall_high_s=max(walls),
        further_s=statistics.median(further) if further else None,
        peak_rss_MB=max(each.peak_rss_MB for each in answers),
        repeats=len(answers),
    )


def reached(own: Iterable[Point], level: float, further: bool = False) -> Reached:
    """The time at which one program's error falls to ``level`` for good as its ITS gets shorter.

    It is that of a whole process or of a ``further`` drop. Between two settings the logarithm of
    time goes by that of error along a straight line.
    """
    near: tuple[float, float] | None = None
    for point in sorted(own, key=lambda point: point.setting.its_s):
        error, time_s = point.errors[QUANTITIES[0]], point.wall_s
        if further:
            if point.further_s is None:
                return Reached(level, None)
            time_s = point.further_s
        if error > level:
            return Reached(level, None if near is None else _between((error, time_s), near, level))
        near = error, time_s
    return Reached(level, near[1] if near else None, coarsest=near is not None)


def _between(far: tuple[float, float], near: tuple[float, float], level: float) -> float:
    # an error of zero would have no logarithm
    part = math.log(far[0] / level) / math.log(far[0] / max(near[0], 1e-300))
    return far[1] * (near[1] / far[1]) ** part


def blocks(found: Sequence[Point]) -> list[list[Point]]:
    """The points of one physics and mesh each, in the order of the runs."""
    groups: dict[tuple[str, tuple[int, int, int]], list[Point]] = {}
    for point in found:
        groups.setdefault((point.setting.physics.name, point.setting.cells), []).append(point)
    return list(groups.values())


def by_program(own: Sequence[Point]) -> dict[str, list[Point]]:
    """The points of each program."""
    groups: dict[str, list[Point]] = {}
    for point in own:
        groups.setdefault(point.program, []).append(point)
    return groups
