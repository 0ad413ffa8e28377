"""What the outcomes of a blind benchmark amount to: rates with exact intervals beside targets."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from scipy.stats import beta, chi2

LEVEL = 0.95
# Held-out errors beyond so many times the noise are not explained; more where drops are few.
NOISE = 1.2
# Ends of the classes of stated probabilities.
PROBABILITIES = (0.02, 0.2, 0.5, 0.8, 0.95, 1.01)
Outcome = dict[str, Any]


@dataclass(frozen=True)
class Line:
    """A share with its exact interval, or a number without one. ``bounds`` are the target's."""

    row: str
    quantity: str
    value: float
    count: int
    of: int
    low: float = math.nan
    high: float = math.nan
    target: str = ""
    bounds: tuple[float, float] = (-math.inf, math.inf)

    @property
    def missed(self) -> str:
        """Whether the target is missed, and whether the whole interval lies beyond it."""
        least, most = self.bounds
        if least <= self.value <= most:
            return ""
        return "missed" if self.low <= most and self.high >= least else "MISSED"

    def __str__(self) -> str:
        what = f"{self.row:<26}{self.quantity:<56}"
        if math.isnan(self.low):
            return f"{what}{self.value:7.2f}{'':>12}{self.of:>5}  {self.target:<12}{self.missed}"
        interval = f"[{100 * self.low:.0f}, {100 * self.high:.0f}]"
        shown = f"{100 * self.value:5.1f} %{interval:>12}{self.of:>5}"
        return f"{what}{shown}  {self.target:<12}{self.missed}"


def exact(count: int, of: int, level: float = LEVEL) -> tuple[float, float]:
    """Interval of a binomial share (Clopper and Pearson, Biometrika 26, 1934)."""
    tail = 0.5 * (1.0 - level)
    low = float(beta.ppf(tail, count, of - count + 1)) if count else 0.0
    high = float(beta.ppf(1.0 - tail, count + 1, of - count)) if count < of else 1.0
    return low, high


def named(outcome: Outcome) -> bool:
    return outcome["verdict"] in ("effect", "ambiguous")


def explained(outcome: Outcome) -> bool:
    """Whether what was named leaves no more than noise on drops that took no part."""
    held = outcome["held_out"]
    if not named(outcome) or not held:
        return False
    n = len(held["groups"])
    most = max(NOISE, math.sqrt(float(chi2.ppf(0.95, n)) / n))
    if outcome["moved"] == 0:
        return bool(held["rms_after"] <= most * outcome["noise_mm"])
    after = outcome["rms_sigma"]
    return after is not None and after <= most


def pays(outcome: Outcome) -> bool:
    """Whether the held-out log score rises, interval above zero; true where it is not told."""
    held = outcome["held_out"] or {}
    low = held.get("log_score_gain_low")
    return low is None or low > 0.0


def covered(outcome: Outcome) -> list[bool]:
    """Whether the 90 % intervals of true parameters hold them, where the true model is reported.

    An effect's parameter is asked of the effect that stands first alone, or of both of a pair.
    """
    if outcome["truth"] == "nothing":
        right = outcome["verdict"] == "adequate"
    elif len(there := _there(outcome)) > 1:
        right = set(outcome["effects"]) == there
    else:
        right = bool(outcome["effects"]) and outcome["effects"][0] == outcome["truth"]
    if not right:
        return []
    found = outcome["parameters"]
    names = [name for name in outcome["true"] if name in found]
    return [found[n]["low"] <= outcome["true"][n] <= found[n]["high"] for n in names]


def astray(outcome: Outcome) -> list[bool]:
    """Whether an estimate lies outside its own interval, parameter by parameter."""
    every = outcome["parameters"].values()
    return [not each["low"] <= each["estimate"] <= each["high"] for each in every]


def lost(outcome: Outcome) -> bool:
    """Whether there is no verdict on the dataset."""
    return outcome["verdict"] in ("refused", "not made")


def table(outcomes: Iterable[Outcome]) -> list[Line]:
    """All lines that ``outcomes`` have something to say to."""
    done = [each for each in outcomes if not lost(each)]
    by: dict[str, list[Outcome]] = {}
    for each in done:
        by.setdefault(each["row"], []).append(each)
    lines = [*_adequate(by), *_quiet(by)]
    for row in ("listed16", "listed8", "films16"):
        lines += _listed(row, by.get(row, []))
    for row, least in (("unlisted16", 0.9), ("unlisted8", 0.6)):
        lines += _unlisted(row, by.get(row, []), least)
    lines += [*_pairs("pairs", by.get("pairs", [])), *_calibrated(done)]
    claims = [each for each in done if named(each)]
    told = [each for each in claims if "log_score_gain_low" in (each["held_out"] or {})]
    lines += _share("all", "named although the held-out log score does not rise",
                    [not pays(each) for each in told], most=0.0)  # fmt: skip
    for row, own in by.items():
        hits = [hit for each in own for hit in covered(each)]
        lines += _share(row, "90 % intervals that hold the truth", hits, 0.87, 0.93)
        for name in sorted({each["truth"] for each in own} if row.startswith("listed") else ()):
            mine = [hit for each in own if each["truth"] == name for hit in covered(each)]
            lines += _share(row, f"  of {name}", mine)
    lines += _share("all", "estimates outside their own interval",
                    [hit for each in done for hit in astray(each)], most=0.0)  # fmt: skip
    lines += _number("all", "seconds a dataset, median", [each["wall_s"] for each in done])
    return lines


def _adequate(by: dict[str, list[Outcome]]) -> list[Line]:
    """Misfits that were called adequate."""
    lines, every = [], []
    for row in ("gross", "unlisted16", "listed16", "films16"):
        own = by.get(row, [])
        hits = [each["verdict"] == "adequate" for each in own]
        every += hits
        lines += _share(row, "a misfit called adequate", hits, most=0.0)
    return [*_share("all of d ≥ 16", "a misfit called adequate", every, most=0.0), *lines]


def _quiet(by: dict[str, list[Outcome]]) -> list[Line]:
    """Data with nothing missing that were not called adequate."""
    lines, every = [], []
    for row in ("clean", "noise", "films"):
        own = by.get(row, [])
        every += own if row != "films" else []
        lines += _share(row, "nothing missing, not called adequate", _alarms(own), most=0.05)
    for noise in sorted({each["noise"] for each in every}):
        own = [each for each in every if each["noise"] == noise]
        lines += _share("clean and noise", f"  under {noise} noise", _alarms(own))
    for columns in sorted({tuple(each["columns"]) for each in every}):
        own = [each for each in every if tuple(each["columns"]) == columns]
        lines += _share("clean and noise", f"  of {_words(columns)}", _alarms(own))
    both = _share(
        "clean and noise", "nothing missing, not called adequate", _alarms(every), 0.0, 0.05
    )
    return [*both, *lines]


def _alarms(own: Sequence[Outcome]) -> list[bool]:
    return [each["verdict"] != "adequate" for each in own]


def _words(columns: Sequence[int]) -> str:
    return "heights" + "".join((", times", ", forces")[c - 1] for c in columns if c)


def _listed(row: str, own: Sequence[Outcome]) -> list[Line]:
    """One listed effect: exact names, classes beside them."""
    aimed = row != "listed8"
    lines = _share(row, "exact name in the set", [_in(each) for each in own], 0.95 * aimed)
    lines += _share(row, "exact name first", [_first(each) for each in own], 0.85 * aimed)
    lines += _share(row, "its class first", [_alike(each) for each in own])
    for verdict in ("adequate", "unknown"):
        lines += _share(row, f"called {verdict}", [each["verdict"] == verdict for each in own])
    rich = [len(each["effects"]) for each in own if named(each) and len(each["columns"]) > 1]
    alone = [len(each["effects"]) for each in own if named(each) and len(each["columns"]) == 1]
    lines += _number(row, "size of the set, median, with times or forces", rich, 2.0)
    lines += _number(row, "size of the set, median, heights alone", alone, 4.0)
    for name in sorted({each["truth"] for each in own}):
        mine = [_in(each) for each in own if each["truth"] == name]
        lines += _share(row, f"  {name} in the set", mine)
    return lines


def _pairs(row: str, own: Sequence[Outcome]) -> list[Line]:
    """Two listed effects."""
    both = [_there(each) <= set(each["effects"]) for each in own]
    lines = _share(row, "both names in the set", both, 0.8)
    third = [bool(set(each["effects"]) - _there(each)) for each in own]
    lines += _share(row, "a wrong name in the set", third)
    rich = [wrong and hit for wrong, hit in zip(third, both, strict=True)]
    lines += _share(row, "a wrong third", rich, most=0.05)
    likely = [_likely(each) - _there(each) for each in own]
    lines += _share(
        row,
        "a wrong third, likely",
        [hit and bool(wrong) for hit, wrong in zip(both, likely, strict=True)],
    )
    bold = [each["verdict"] == "effect" and not set(each["effects"]) & _there(each) for each in own]
    lines += _share(row, "wrong names alone", bold, most=0.03)
    for verdict in ("adequate", "unknown"):
        lines += _share(row, f"called {verdict}", [each["verdict"] == verdict for each in own])
    return lines


def _calibrated(done: Sequence[Outcome]) -> list[Line]:
    """How many of the effects that are given some probability are there."""
    told = [
        (value, name in _there(each))
        for each in done
        if each["row"] not in ("gross", "unlisted8", "unlisted16")
        for name, value in (each.get("probabilities") or {}).items()
    ]
    lines = []
    for low, high in pairwise(PROBABILITIES):
        hits = [hit for value, hit in told if low <= value < high]
        bounds = (0.75, 0.97) if (low, high) == (0.8, 0.95) else (0.0, 1.0)
        words = f"effects given {low:g} to {min(high, 1.0):g} that are there"
        lines += _share("all", words, hits, *bounds)
    return lines


def _likely(outcome: Outcome) -> set[str]:
    """The effects that the answer calls more probable than not."""
    stated = outcome.get("probabilities") or {}
    return {name for name, value in stated.items() if value > 0.5}


def _there(outcome: Outcome) -> set[str]:
    """The effects that are in the data."""
    return set(outcome["truth"].split(" with "))


def _unlisted(row: str, own: Sequence[Outcome], least: float) -> list[Line]:
    """A misfit that no list has."""
    right = [each["verdict"] == "unknown" or explained(each) for each in own]
    lines = _share(row, "unknown, or explained to within the noise", right, least)
    lines += _share(row, "unknown", [each["verdict"] == "unknown" for each in own])
    lines += _share(row, "called adequate", [each["verdict"] == "adequate" for each in own])
    for family in sorted({each["truth"] for each in own}):
        mine = [ok for ok, each in zip(right, own, strict=True) if each["truth"] == family]
        lines += _share(row, f"  right of {family}", mine)
    return lines


def _in(outcome: Outcome) -> bool:
    return outcome["truth"] in outcome["effects"]


def _first(outcome: Outcome) -> bool:
    return outcome["effects"][:1] == [outcome["truth"]]


def _alike(outcome: Outcome) -> bool:
    truth = outcome["truth"]
    alike = {truth}.union(*(group for group in outcome["classes"] if truth in group))
    return bool(outcome["effects"]) and outcome["effects"][0] in alike


def _share(
    row: str, quantity: str, hits: Sequence[bool], least: float = 0.0, most: float = 1.0
) -> list[Line]:
    if not hits:
        return []
    count, of = sum(hits), len(hits)
    target = ""
    if least > 0.0 and most < 1.0:
        target = f"{100 * least:.0f} to {100 * most:.0f} %"
    elif least > 0.0:
        target = f"≥ {100 * least:.0f} %"
    elif most < 1.0:
        target = f"≤ {100 * most:.0f} %" if most else "0"
    return [Line(row, quantity, count / of, count, of, *exact(count, of), target, (least, most))]


def _number(row: str, quantity: str, values: Sequence[float], most: float = math.inf) -> list[Line]:
    if not values:
        return []
    target = f"≤ {most:g}" if math.isfinite(most) else ""
    middle = float(statistics.median(values))
    return [Line(row, quantity, middle, len(values), len(values), target=target,
                 bounds=(-math.inf, most))]  # fmt: skip
