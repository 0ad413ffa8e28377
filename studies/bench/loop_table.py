"""What do the outcomes of a benchmark of the loop amount to, row by row?"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from scipy.stats import beta

from .loop_cases import ROWS, Row

LEVEL = 0.95
Outcomes = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Line:
    """One quantity of one row: a share with its exact interval, or a number without one.

    ``target`` is what the loop is asked for, as text.
    """

    row: str
    quantity: str
    count: int
    of: int
    value: float
    low: float | None
    high: float | None
    target: str


def share(row: str, quantity: str, hits: Sequence[bool], target: str = "") -> Line | None:
    """A binomial share with the interval of Clopper and Pearson (Biometrika 26, 1934)."""
    n, k = len(hits), sum(hits)
    if n == 0:
        return None
    tail = 0.5 * (1.0 - LEVEL)
    low = float(beta.ppf(tail, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(1.0 - tail, k + 1, n - k)) if k < n else 1.0
    return Line(row, quantity, k, n, k / n, low, high, target)


def number(row: str, quantity: str, values: Sequence[float], target: str = "") -> Line | None:
    """A mean or median that was taken before."""
    if not values:
        return None
    return Line(row, quantity, len(values), len(values), values[0], None, None, target)


def table(outcomes: Outcomes) -> list[Line]:
    """All lines; cases for which no effect has the wanted size are left out."""
    lines: list[Line | None] = []
    for row in ROWS:
        own = [each for each in outcomes if each["row"] == row.name and each["verdict"]]
        lines += _of_row(row, own)
        lines += _rivals(row, own)
    return [line for line in lines if line is not None]


def _of_row(row: Row, own: Outcomes) -> list[Line | None]:
    name = row.name
    if not row.d:
        limit = "≤ 5 %" if row.noise == "gaussian" else "≤ 8 %"
        return [
            share(name, "called anything but adequate", _say(own, lambda o: not _fine(o)), limit),
            share(name, "intervals of parameters that cover", _covered(own), "87 to 93 %"),
        ]
    if row.unlisted:
        target = "≥ 85 %" if row.d == 8.0 else "≥ 95 %"
        wrong = _say(own, lambda o: o["verdict"] in ("effect", "ambiguous"))
        return [
            share(name, "called unknown", _say(own, lambda o: o["verdict"] == "unknown"), target),
            share(name, "named a listed effect", wrong),
            share(name, "called adequate", _say(own, _fine)),
        ]
    if row.listed > 1:
        return [share(name, "both classes found", _say(own, _both), "≥ 70 %")]
    found = [o for o in own if o["effects"]]
    sizes = [len(o["effects"]) for o in found]
    best = [o["ideal"][0] for o in found]
    gained = [
        (o["before"] - o["after"]) / (o["before"] - o["oracle"])
        for o in own
        if o["before"] is not None and o["before"] > 1.1 * o["oracle"]
    ]
    return [
        share(
            name,
            "true effect in the set",
            _say(own, lambda o: set(o["truth"]) <= set(o["effects"])),
            "≥ 95 %",
        ),
        share(name, "true class first", _say(own, _first), "≥ 90 %"),
        share(
            name, "wrongly called unknown", _say(own, lambda o: o["verdict"] == "unknown"), "≤ 5 %"
        ),
        share(name, "called adequate", _say(own, _fine)),
        number(name, "mean size of the set over an ideal reader's", _ratio(sizes, best), "≤ 1.3"),
        number(name, "mean size of an ideal reader's set", _mean([o["ideal"][0] for o in own])),
        number(
            name,
            "held-out error recovered, median",
            _median(gained),
            "≥ 0.7" if row.apart else "≥ 0.8",
        ),
        share(name, "intervals of parameters that cover", _covered(own), "87 to 93 %"),
    ]


def _say(own: Outcomes, what: Callable[[dict[str, Any]], bool]) -> list[bool]:
    return [bool(what(each)) for each in own]


def _fine(outcome: dict[str, Any]) -> bool:
    return bool(outcome["verdict"] == "adequate")


def _first(outcome: dict[str, Any]) -> bool:
    return bool(outcome["effects"]) and outcome["effects"][0] in outcome["same"]


def _both(outcome: dict[str, Any]) -> bool:
    """Whether every true effect, or one that the data cannot tell from it, was named."""
    named = set(outcome["effects"])
    groups = outcome.get("classes", [])
    for truth in outcome["truth"]:
        alike = {name for group in groups if truth in group for name in group} | {truth}
        if not named & alike:
            return False
    return True


def _covered(own: Outcomes) -> list[bool]:
    return [hit for each in own for hit in each["covered"]]


def _ratio(sizes: Sequence[int], best: Sequence[int]) -> list[float]:
    return [sum(sizes) / sum(best)] if sizes else []


def _mean(values: Sequence[float]) -> list[float]:
    return [statistics.fmean(values)] if values else []


def _median(values: Sequence[float]) -> list[float]:
    return [statistics.median(values)] if values else []


def _rivals(row: Row, own: Outcomes) -> list[Line | None]:
    """The same data, what simpler methods say right of them."""
    lines = []
    for method in sorted({name for each in own for name in each["rivals"]}):
        right = [_right(row, each, each["rivals"][method]) for each in own]
        lines.append(share(row.name, f"right by {method} alone", right))
    right = [_right(row, each, None) for each in own]
    return [*lines, share(row.name, "right by the loop", right)]


def _right(row: Row, outcome: dict[str, Any], said: str | None) -> bool:
    """Whether ``said`` (None: what the loop said) is right, by the class of its first name."""
    if said is None:
        named = outcome["effects"]
        said = named[0] if named else outcome["verdict"]
    if not row.d:
        return said == "adequate"
    if row.unlisted:
        return said == "unknown"
    return said in outcome["same"]
