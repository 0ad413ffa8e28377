"""Finding of the loop: verdict, evidence and errors, as verdict.json and the figures have them."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from typing import Any

from ...solver.arrays import Array
from .adequacy import Test
from .heldout import HeldOut
from .noise import Ints
from .problem import Entry, Model, Problem
from .profile import Limit

# An effect that is named alone and is less probable has a doubt beside it.
SURE = 0.9
# A parameter whose bounds are nearer to each other than this share of it is known well enough: that
# data tell no more of it is no doubt. Only where something is missing does it matter whether they
# press against its bounds.
KNOWN = 0.05
SEEN_BY = "what is missing is seen by this: "
# Below it the tails of distributions are rounding.
LEAST_P = 1e-300


def p_text(p_value: float, shown: Callable[[float], str] = "{:.2g}".format) -> str:
    """A p-value as a sentence has it: what it is, or below what it is where it hardly is a
    number."""
    return f"p < {LEAST_P:g}" if p_value <= LEAST_P else f"p = {shown(p_value)}"


class Verdict(StrEnum):
    """The four answers of CONTRACT.md."""

    ADEQUATE = "adequate"
    EFFECT = "effect"
    AMBIGUOUS = "ambiguous"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Interval:
    """An estimate with its 90 % interval."""

    estimate: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Evidence:
    """A model that was fitted: log evidence, p-value of what it leaves (None where that was not
    asked), why it does not hold (empty where it does), parameters at the best fit."""

    effects: tuple[str, ...]
    log_evidence: float
    left_p_value: float | None
    why_not: str
    theta: tuple[float, ...]


@dataclass(frozen=True)
class Near:
    """The known effect, or the two, that explain most: their share of the misfit beyond noise, the
    rms in sigma that they leave, and why they do not hold (empty where they do)."""

    effects: tuple[str, ...]
    share: float
    leaves_sigma: float
    why_not: str

    def words(self) -> str:
        """One sentence."""
        more = "" if len(self.effects) > 1 else "s"
        return (
            f"{' with '.join(self.effects)} explain{more} {100 * self.share:.0f} % of it "
            f"and leave{more} {self.leaves_sigma:.2g} sigma"
        )


@dataclass(frozen=True)
class Proposal:
    """What to measure next, which effects it separates, and by how many nats more."""

    change: str
    separates: tuple[str, ...]
    expected_gain: float


@dataclass(frozen=True)
class Finding:
    """All that verdict.json and the report's figures need.

    ``problem`` is the data with the errors that they were fitted with, declared or replaced.
    ``reported`` are the effects of each model that explains the data, the likeliest first,
    ``weights`` the shares of these effects in them, ``probabilities`` those that effects are in the
    data, whatever is reported; ``noticed`` says by what else than the tests something is seen to be
    missing.
    ``rows`` numbers the problem's rows that were fitted; ``residual_before`` are their quantile
    residuals. ``theta`` are the likeliest parameters of the reported ``model``, ``parameters``
    posterior medians with intervals. ``unlike`` is a record that nothing known explains with the
    others, where that may be what is wrong. ``remarks`` tell what parameters do not, such as where
    an effect acts, by reported model and by effect.
    ``unlisted`` is the log evidence of the best shape that no effect has, ``shape``, on the scale
    of ``evidences``. ``limits`` and ``needed_d``: in which directions, and at which size, an effect
    is noticed nine times in ten.
    """

    problem: Problem
    verdict: Verdict
    weights: Mapping[str, float]
    probabilities: Mapping[str, float]
    reported: tuple[tuple[str, ...], ...]
    statistic: str
    p_value: float
    open_set_p_value: float
    tests: tuple[Test, ...]
    tests_after: tuple[Test, ...]
    parameters: Mapping[str, Interval]
    unidentified: tuple[str, ...]
    at_bounds: tuple[str, ...]
    classes: tuple[tuple[str, ...], ...]
    limits: Mapping[str, tuple[Limit, ...]]
    needed_d: Mapping[str, float]
    evidences: tuple[Evidence, ...]
    unlisted: float
    shape: str
    nearest: Near | None
    noise: Mapping[str, float | str]
    rms_before: float
    rms_after: float
    coverage_90: float
    held_out: HeldOut | None
    next_experiment: Proposal | None
    model: Model
    theta: Array
    rows: Ints
    residual_before: Array
    noticed: str
    warnings: tuple[str, ...]
    bookkeeping: tuple[Entry, ...]
    unlike: Entry | None
    remarks: Mapping[tuple[str, ...], Mapping[str, str]]
    seed: int
    alarm: float

    @property
    def together(self) -> tuple[tuple[str, ...], ...]:
        """Reported effects that explain the data only together."""
        return tuple(names for names in self.reported if len(names) > 1)

    @property
    def effects(self) -> tuple[str, ...]:
        """The reported effects, the likeliest first."""
        return tuple(sorted(self.weights, key=lambda name: -self.weights[name]))

    @property
    def detectable(self) -> dict[str, float | None]:
        """The least size at which each effect is noticed, in the direction that shows it best."""
        return {
            name: min((each.size for each in limits), default=None)
            for name, limits in self.limits.items()
        }

    def all_warnings(self) -> list[str]:
        """Sentences on what deserves doubt."""
        out = [each for each in (self.noticed and SEEN_BY + self.noticed, *self.warnings) if each]
        unsure = [name for name in self.effects if self.probabilities[name] < SURE]
        if unsure and self.verdict is Verdict.EFFECT:
            out += [
                f"{name} is in these data with a probability of {self.probabilities[name]:.2g} only"
                for name in unsure
            ]
        known = {
            each.name: each
            for each in self.model.parameters
            if each.high - each.low < KNOWN * abs(each.null)
        }
        pressed = set(self.at_bounds) - set(self.unidentified)
        if self.verdict is not Verdict.ADEQUATE:
            out += [
                f"{name} lies on a bound, and may be {each.low:.4g} to {each.high:.4g} only"
                f"{f' ({each.why})' * bool(each.why)}: if it may be more or less in your data, "
                "that could be what is missing"
                for name, each in known.items()
                if name in pressed
            ]
        on_bound = [each for each in self.at_bounds if each not in known]
        if on_bound:
            out.append(f"at an end of the range that was searched: {', '.join(on_bound)}")
        untold = [each for each in self.unidentified if each not in known]
        if untold:
            out.append(f"these data do not determine: {', '.join(untold)}")
        if self.noise["finding"]:
            out.append(f"the noise: {self.noise['finding']}")
        if self.nearest is not None and self.verdict is Verdict.UNKNOWN:
            out.append(f"{self.nearest.words()}; {self.nearest.why_not}")
        return out

    def verdict_json(self) -> dict[str, Any]:
        """The keys of verdict.json (CONTRACT.md) but ``confirmed_in_3d``, which others add."""
        return {
            "verdict": str(self.verdict),
            "effects": list(self.effects),
            "weights": {name: self.weights[name] for name in self.effects},
            "probabilities": dict(self.probabilities),
            "together": plain(self.together),
            "detection": {"statistic": self.statistic, "p_value": self.p_value},
            "open_set": {"p_value": self.open_set_p_value},
            "parameters": plain(self.parameters),
            "unidentified": list(self.unidentified),
            "classes": plain(self.classes),
            "detectable": self.detectable,
            "fit": {
                "rms_sigma_before": self.rms_before,
                "rms_sigma": self.rms_after,
                "coverage_90": self.coverage_90,
                "at_bounds": list(self.at_bounds),
            },
            "nearest": plain(self.nearest),
            "noise": dict(self.noise),
            "warnings": self.all_warnings(),
            "lead": self.problem.lead,
            "left_aside": list(self.problem.left_aside),
            "bookkeeping": plain(self.bookkeeping),
            "remarks": dict(ChainMap(*map(dict, self.remarks.values()))),
            "held_out": None if self.held_out is None else self.held_out.keys(),
            "next_experiment": plain(self.next_experiment),
            "seed": self.seed,
        }


def plain(record: Any) -> Any:
    """A record, or a collection of them, as JSON has it."""
    if is_dataclass(record):
        return {each.name: plain(getattr(record, each.name)) for each in fields(record)}
    if isinstance(record, Mapping):
        return {key: plain(value) for key, value in record.items()}
    return [plain(each) for each in record] if isinstance(record, list | tuple) else record
