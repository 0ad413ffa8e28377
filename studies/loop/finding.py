"""What was found, and how is it told: to verdict.json and to the figures?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from ...solver.bristle import Array
from .heldout import HeldOut
from .noise import Ints


class Verdict(StrEnum):
    """The four answers of CONTRACT.md."""

    ADEQUATE = "adequate"
    EFFECT = "effect"
    AMBIGUOUS = "ambiguous"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Test:
    """One test of the family: its value and its p-value alone."""

    name: str
    value: float
    p_value: float


@dataclass(frozen=True)
class Interval:
    """An estimate with its 90 % interval."""

    estimate: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Evidence:
    """A model that was refitted: log evidence, size d, p-value of what it leaves (None where that
    was not asked), parameters at the best fit."""

    effects: tuple[str, ...]
    log_evidence: float
    weight: float
    d: float
    left_p_value: float | None
    theta: tuple[float, ...]


@dataclass(frozen=True)
class Proposal:
    """What to measure next, which effects it separates, and by how many nats more."""

    change: str
    separates: tuple[str, ...]
    expected_gain: float


@dataclass(frozen=True)
class Finding:
    """All that verdict.json and the report's figures need.

    ``rows`` numbers the problem's rows that were fitted; ``residual_before``, ``residual_after``
    are theirs in sigma, ``covariates`` what they are drawn against. ``theta`` are the reported
    model's parameters, ``model_effects`` its effects. ``log_evidence_unlisted``: of some smooth
    misfit that no effect names, on the scale of ``evidences``. ``detectable`` and ``needed_d``:
    magnitude and size at which an effect is detected nine times in ten.
    """

    verdict: Verdict
    effects: tuple[str, ...]
    weights: Mapping[str, float]
    together: tuple[tuple[str, ...], ...]
    statistic: str
    p_value: float
    open_set_p_value: float
    tests: tuple[Test, ...]
    tests_after: tuple[Test, ...]
    parameters: Mapping[str, Interval]
    unidentified: tuple[str, ...]
    classes: tuple[tuple[str, ...], ...]
    detectable: Mapping[str, float | None]
    needed_d: Mapping[str, float]
    evidences: tuple[Evidence, ...]
    log_evidence_unlisted: float
    noise: Mapping[str, float | str]
    held_out: HeldOut | None
    next_experiment: Proposal | None
    model_effects: tuple[str, ...]
    theta: Array
    rows: Ints
    residual_before: Array
    residual_after: Array
    covariates: Mapping[str, Array]
    seed: int
    alarm: float

    def verdict_json(self) -> dict[str, Any]:
        """The keys of verdict.json (CONTRACT.md) but ``confirmed_in_3d``, which others add."""
        held = self.held_out
        proposal = self.next_experiment
        return {
            "verdict": str(self.verdict),
            "effects": list(self.effects),
            "weights": dict(self.weights),
            "together": [list(each) for each in self.together],
            "detection": {"statistic": self.statistic, "p_value": self.p_value},
            "open_set": {"p_value": self.open_set_p_value},
            "parameters": {
                name: {"estimate": x.estimate, "low": x.low, "high": x.high, "unit": x.unit}
                for name, x in self.parameters.items()
            },
            "unidentified": list(self.unidentified),
            "classes": [list(each) for each in self.classes],
            "detectable": dict(self.detectable),
            "noise": dict(self.noise),
            "held_out": None
            if held is None
            else {
                "groups": list(held.groups),
                "unit": held.unit,
                "rms_before": held.rms_before,
                "rms_after": held.rms_after,
                "reduction_low": held.reduction_low,
                "reduction_high": held.reduction_high,
                "coverage_90": held.coverage_90,
            },
            "next_experiment": None
            if proposal is None
            else {
                "change": proposal.change,
                "separates": list(proposal.separates),
                "expected_gain": proposal.expected_gain,
            },
            "seed": self.seed,
        }
