"""A finding's first sentences, for a reader who knows nothing of the loop."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...solver.effects.base import Parameter
from ...solver.effects.library import EFFECTS
from ..loop.adequacy import WIDER_NOISE
from ..loop.finding import Finding, Verdict, p_text
from ..loop.heldout import HeldOut
from ..loop.problem import Problem
from ..loop.profile import Limit
from ..loop.shapes import MOST_SHARED
from .rows import COVARIATES, title_of

# What a test or a shape shows, by how its name begins; the rest of the name is a covariate's.
SEEN = {
    "size": "the data lie farther from the model than their errors allow",
    "level": "the data lie off the model to the same side everywhere",
    "trend with ": "what the model leaves grows or falls steadily with {}",
    "smooth in ": "what the model leaves bends with {}",
    "band of ": "the data are off in one range of {}",
    "wave in ": "what the model leaves rises and falls with {}",
    "waves in ": "what the model leaves rises and falls with {}",
    "scatter with ": "the data scatter more and more with {}",
    "scatter in a band of ": "the data scatter more in one range of {}",
    "scatter of one in several": "one in several of the data scatters more",
    "one in several of the order": "one in several of the data is off",
    "settling in the order": "the first of the data are off, and the later ones less and less",
    "runs": "values measured one after another lie on the same side of the model",
    "two states": "the data look like two groups that are off by different amounts",
    "shared within a group": "what was read of one drop is off together",
    "any function of ": "what the model leaves changes with {}",
    WIDER_NOISE: "the data lie farther from the model than their errors allow",
}
# Once in more than this is told no closer.
RAREST = 1e9
# Nats by which a shape must be likelier than the baseline alone to be told.
CLEARLY = 3.0
# An error that stays above this share of itself is one that the effect hardly changes.
HARDLY = 0.8
# Fewer drops than this show so little that it has to be said; and fewer records in time, of which
# none can be held out.
ENOUGH_GROUPS, ENOUGH_RECORDS = 12, 4
# What a group is, one and several, by the kind of data; others have drops.
GROUPS = {"falls": ("fall", "falls"), "waves": ("pass", "passes")}


def names_of_groups(kind: str) -> tuple[str, str]:
    """What a group of a ``kind`` of data is called, one and several."""
    return GROUPS.get(kind, ("drop", "drops"))


def opening(finding: Finding) -> list[str]:
    """The verdict and what it is worth, in plain sentences."""
    told = [_verdict(finding), _chance(finding)]
    if lead := finding.problem.lead:
        told.insert(0, f"Before all: {lead}" + "." * (lead[-1] not in ".?"))
    if finding.held_out is not None and finding.model.effects:
        told.append(_held(finding, finding.held_out))
    return told


def _held(finding: Finding, held: HeldOut) -> str:
    """What becomes of the error on held-out data: of the main quantity or, where that hardly
    changes, of the one that the effect changes most."""
    before, after, noise = (f"{each:.2g}" for each in (held.rms_before, held.rms_after, held.sigma))
    where = "On data that took no part in the fit, the error"
    falls = held.rms_after < held.rms_before
    if np.asarray(finding.model.weights).size > 1 and not falls:
        return (
            f"On data that took no part in the fit, the size of the error stays {after} "
            f"{held.unit}. What differs by chance cannot be predicted, but its spread can."
        )
    gains = {name: one**2 - other**2 for name, (one, other) in held.by_quantity.items()}
    changed = max(gains, key=lambda name: gains[name])
    main = finding.problem.main_quantity
    elsewhere = changed != main and gains[changed] > 0.0
    if elsewhere and held.rms_after > HARDLY * held.rms_before:
        one, other = (f"{each:.2g}" for each in held.by_quantity[changed])
        return (
            f"{where} of {changed} falls from {one} to {other} standard deviations. That of "
            f"{main.removesuffix(f' ({held.unit})')} is {after} {held.unit}; noise alone makes "
            f"{noise} {held.unit}."
        )
    return (
        f"{where} {'falls' if falls else 'rises'} from {before} to {after} {held.unit}; noise "
        f"alone makes {noise} {held.unit}."
    )


def _verdict(finding: Finding) -> str:
    if finding.verdict is Verdict.ADEQUATE:
        return "Nothing is missing that these data could show: what the model leaves is noise."
    seen = _seen(finding)
    if finding.verdict is Verdict.UNKNOWN:
        best = max(each.log_evidence for each in finding.evidences)
        shape = f" A shape explains more than any of them does: {finding.shape}."
        return (
            f"{seen}, and no effect that is known here explains it."
            f"{shape if finding.unlisted > best else ''}"
        )
    if finding.verdict is Verdict.EFFECT:
        (names,) = finding.reported
        return f"{seen}; {_with_sizes(finding, names)} explain{'s' * (len(names) == 1)} it."
    each = "; ".join(
        " with ".join(_titled(finding, names, name) for name in names) for names in finding.reported
    )
    return f"{seen}. Each of these explains it, and these data do not tell which: {each}."


def _seen(finding: Finding) -> str:
    """What shows that something is missing; the beginning of a sentence."""
    if finding.noticed:
        return finding.noticed[:1].upper() + finding.noticed[1:]
    if np.asarray(finding.model.weights).size > 1:
        return "What was measured varies more than its errors allow"
    name = finding.statistic
    # which has no form: any test that has one says more
    wide = finding.shape.startswith(WIDER_NOISE) and name not in finding.needed_d
    if finding.unlisted > finding.evidences[0].log_evidence + CLEARLY and not wide:
        name = finding.shape  # the likeliest, while the least p-value may be of any that is alike
    if name in finding.needed_d:  # an effect's own test: which effect it is comes after
        return "Something is missing from the model"
    start = max((each for each in SEEN if name.startswith(each)), key=len, default="size")
    covariate = name.removeprefix(start).removeprefix("the ")
    label = COVARIATES[covariate].label if covariate in COVARIATES else covariate
    words = SEEN[start].format(label if label == "time" else f"the {label}")
    return words[:1].upper() + words[1:]


def _with_sizes(finding: Finding, names: Sequence[str]) -> str:
    """Effects in words, each with its first parameter and that one's 90 % interval."""
    told = []
    for name in names:
        size = ""
        if own := next((each for each in _parameters(name) if each in finding.parameters), ""):
            # effects before this one may have parameters of the same name: theirs come first
            before = names[: names.index(name)]
            count = sum(_parameters(each).count(own) for each in before)
            alike = [e for e in finding.parameters if re.fullmatch(rf"{own}(_\d+)?", e)]
            found = finding.parameters[alike[count]]
            value = quantity(own, f"{found.estimate:.3g}", found.unit)
            size = f" ({value}, 90 % interval {found.low:.3g} to {found.high:.3g})"
        told.append(_titled(finding, names, name) + size)
    return " with ".join(told)


def _parameters(name: str) -> list[str]:
    """The names of an effect's parameters."""
    return [each.name for each in EFFECTS[name].parameters] if name in EFFECTS else []


def _titled(finding: Finding, names: Sequence[str], name: str) -> str:
    """An effect in words, with where it acts in the reported model with the effects ``names``."""
    return f"{title_of(name)} {finding.remarks.get(tuple(names), {}).get(name, '')}".rstrip()


def _chance(finding: Finding) -> str:
    """What the p-value of the first tests means."""
    p = f"({p_text(finding.p_value)})"
    if finding.noticed:
        return f"The tests of the fitted data alone do not show it {p}."
    return f"If nothing were missing, data as odd as these would come {times(finding.p_value)} {p}."


def times(p: float) -> str:
    """A probability as a count."""
    p = float(f"{p:.2g}")
    if p >= 0.1:
        return f"in {100 * p:.0f} of 100 cases"
    if p >= 0.01:
        return f"in {1000 * p:.0f} of 1,000 cases"
    if p * RAREST < 1.0:
        return "less than once in a billion times"
    return f"once in {float(f'{1.0 / p:.2g}'):,.0f} times"


def would_have_shown(finding: Finding, problem: Problem) -> list[str]:
    """The smallest size of each effect that these data show nine times in ten."""
    told, base = [], len(problem.baseline.parameters)
    for each in problem.candidates:
        (name,), first = each.effects, each.parameters[base]
        limits = finding.limits.get(name, ())
        if limits:
            told.append(f"{title_of(name)} from {_limits(first, limits)}")
    return told


def _limits(first: Parameter, limits: Sequence[Limit]) -> str:
    """From where on an effect shows by its ``first`` parameter: in each direction by itself, if
    that is not from zero on in all directions that there are."""
    one_way = not first.low < first.null < first.high
    if (not first.null or math.isinf(first.null)) and (one_way or len(limits) > 1):
        widest = max(limits, key=lambda each: each.size)
        size = quantity(first.name, f"{widest.size:.2g}", first.unit)
        return f"{'less than ' * widest.least}{size} on"
    told: list[str] = []
    for each in limits:
        digits = 1 - math.floor(math.log10(min(each.size, abs(each.value)) or 1.0))
        value = quantity("" if told else first.name, f"{round(each.value, digits):g}", first.unit)
        nearer = f" or nearer to {first.null:g}" * each.least
        told.append(f"{value}{nearer} {'up' if each.upward else 'down'}")
    return " or ".join(told)


def few_data(finding: Finding, problem: Problem, kind: str) -> dict[str, Any] | None:
    """What so few drops or falls can and cannot show, by effect; None where they are enough."""
    groups, rows = np.unique(problem.group, return_counts=True)
    enough = ENOUGH_RECORDS if rows.mean() > MOST_SHARED else ENOUGH_GROUPS
    if groups.size >= enough:
        return None
    hidden = [name for name, least in finding.detectable.items() if least is None]
    return {
        "groups": f"{groups.size} {names_of_groups(kind)[1]}",
        "can_show": would_have_shown(finding, problem),
        "cannot_show": [title_of(name) for name in hidden],
    }


def on_few(few: dict[str, Any]) -> list[str]:
    """Lines on what `few_data` has."""
    these = f"Only {few['groups']}"
    if not few["can_show"]:
        told = [f"{these}: they can show no effect at any size within its bounds."]
    else:
        told = [f"{these}. Nine times in ten they would show:", *few["can_show"]]
        if few["cannot_show"]:
            told.append(f"They cannot show, at any size: {', '.join(few['cannot_show'])}.")
    return [*told, "Smaller effects may be there all the same. More data would show them."]


def quantity(name: str, value: str, unit: str) -> str:
    """A parameter with its value and unit; a unit that says what it is stands alone."""
    return (f"{value} {unit}" if unit.startswith(name) else f"{name} {value} {unit}").rstrip()
