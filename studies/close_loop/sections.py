"""Sections of a closed loop's page: of each step its words, its figure and its tables.

Every run writes the same tables, so that none of an earlier run stays beside a new page.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtri

from ...solver.effects.base import Parameter
from ..loop.finding import p_text
from ..loop.heldout import HeldOut
from ..loop.problem import Model
from ..report.page import Head, Section, show
from ..report.prose import Draft, Prose
from . import figures
from .confirm import Solid
from .directions import directions
from .opening import opening
from .rows import Closed, names_of, title_of

BINS = np.linspace(-6.0, 6.0, 33)
HEADS: dict[str, Head] = {
    "group": "drop, fall or pass",
    "title": "in words",
    "sigma": ("standard deviation", "", 3),
    "shape": "shape chosen",
    "core": ("core over it", "", 3),
    "correlation": ("correlation with the one before", "", 2),
    "why": "why these bounds",
    "direction": "direction (shares of each parameter's range)",
    "deviation": ("standard deviation over the range", "", 2),
    "seen": "the data see it",
    "p_value": ("p alone", "", 2),
    "detectable": ("shows from", "", 3),
    "needed_d": ("that is, in σ", "", 3),
    "class": "cannot be told from",
    "log_evidence": ("log evidence over the baseline's", "nats"),
    "left_p_value": ("p of what it leaves", "", 2),
    "why_not": "why it does not hold",
    "weight": ("share in the verdict", "", 3),
    "probability": ("probability that it is there", "", 3),
    "normal": ("normal quantile", "σ"),
    "reduction_low": ("less by, 90 % from", "", 3),
    "reduction_high": ("to", "", 3),
    "coverage_90": ("within their 90 % interval", "", 3),
    "change": "measure",
    "expected_gain": ("expected gain", "nats"),
}
SIGMA: dict[str, Head] = {"before": ("before", "σ"), "after": ("after", "σ")}
path = Path(__file__).with_name("words.j2")
words_of_p = partial(p_text, shown=partial(show, digits=2))
prose = Prose(path, HEADS, title_of=title_of, names_of=names_of, p_text=words_of_p)


def quantity_of(closed: Closed) -> str:
    """The main quantity with its unit."""
    problem = closed.problem
    name = problem.main_quantity
    return name if "(" in name else f"{name} ({problem.unit})"


def _in_unit(closed: Closed, **heads: str) -> dict[str, Head]:
    """Heads of columns that hold values of the main quantity."""
    return {key: (head, closed.problem.unit, 5) for key, head in heads.items()}


def _attributes(items: Sequence[Any], *names: str) -> dict[str, list[Any]]:
    """Columns of what ``items`` have by these names."""
    return {name: [getattr(each, name) for each in items] for name in names}


def _noise(closed: Closed) -> Section:
    problem, noise = closed.problem, closed.finding.noise
    draft = prose("noise", declared=problem.sigma_declared, noise=noise, notes=problem.notes)
    before, after = (np.histogram(np.clip(x, BINS[0], BINS[-1]), BINS)[0] for x in closed.left)
    counts = {"from_sigma": BINS[:-1], "to_sigma": BINS[1:], "before": before, "after": after}
    drawn = figures.noise_figure(before, after, BINS)
    draft.figure("noise", drawn, draft.data("residual_histogram", counts))
    values = pd.DataFrame({"quantity": problem.quantity, "sigma": problem.scale / closed.unit})
    by_quantity = values.groupby("quantity", sort=False).sigma
    table = by_quantity.agg(values="size", sigma="median").reset_index()
    table["unit"] = [problem.unit, *[""] * (len(table) - 1)]
    chosen = {"shape": noise["shape"], "core": noise["scale"], "correlation": noise["correlation"]}
    draft.table("noise", table.assign(**chosen))
    return draft.section()


def _baseline(closed: Closed) -> Section:
    problem, finding = closed.problem, closed.finding
    theta, parameters = finding.evidences[0].theta, problem.baseline.parameters
    quantity, mine = quantity_of(closed), closed.problem.is_main
    seen = _directions(closed, problem.baseline, theta)
    unseen = [each for each, data in zip(seen["direction"], seen["seen"], strict=True) if not data]
    draft = prose("baseline", unseen=unseen, quantity=quantity)
    values = {
        "group": problem.group[mine],
        **{covariate.name: x[mine] for covariate, x in closed.covariates},
        "measured": closed.measured(problem.values)[mine],
        "before": closed.measured(closed.means[0])[mine],
        "after": closed.measured(closed.means[1])[mine],
        "held_out": closed.held[mine],
    }
    heads = _covariates(closed) | _in_unit(
        closed, measured="measured", before="baseline", after="with what was found"
    )
    draft.figure("baseline", figures.fit_figure(closed, quantity), draft.data("fit", values, heads))
    columns = {
        "parameter": [each.name for each in parameters],
        "estimate": np.asarray(theta),
        **_attributes(parameters, "unit", "low", "high", "why"),
    }
    draft.table("baseline", columns, {"estimate": "best fit", "low": "bounded from"})
    draft.table("baseline_directions", seen)
    return draft.section()


def _covariates(closed: Closed) -> dict[str, Head]:
    return {covariate.name: (covariate.label, covariate.unit) for covariate, _ in closed.covariates}


def _directions(closed: Closed, model: Model, theta: Sequence[float]) -> dict[str, list[Any]]:
    """Directions among parameters, and how well the data tell them."""
    found = directions(model, theta, closed.finding.rows, closed.unit)
    names = [each.name for each in model.parameters]
    words = [each.words(names) for each in found]
    return {"direction": words, **_attributes(found, "deviation", "seen")}


def _residuals(closed: Closed) -> Section:
    problem = closed.problem
    against = ", ".join(covariate.label for covariate, _ in closed.covariates)
    draft = prose("residuals", against=against)
    left = {
        "group": problem.group,
        "quantity": problem.quantity,
        **{covariate.name: x for covariate, x in closed.covariates},
        **dict(zip(("before", "after"), closed.left, strict=True)),
        "held_out": closed.held,
    }
    data = draft.data("residuals", left, _covariates(closed) | SIGMA)
    draft.figure("residuals", figures.residual_figure(closed), data)
    return draft.section()


def _tests(closed: Closed) -> Section:
    finding = closed.finding
    draft = prose("tests", finding=finding)
    drawn = figures.tests_figure(finding.tests, finding.tests_after, finding.p_value)
    draft.figure("tests", drawn, draft.data("tests", _tested(finding.tests)))
    return draft.section()


def _tested(tests: Sequence[Any]) -> dict[str, list[Any]]:
    """Tests with their values and p-values alone."""
    return {"test": [each.name for each in tests], **_attributes(tests, "value", "p_value")}


def _detectable(closed: Closed) -> Section:
    finding, problem = closed.finding, closed.problem
    base = len(problem.baseline.parameters)
    own = {each.effects[0]: each.parameters[base] for each in problem.candidates}
    draft = prose("detectable", alike=[each for each in finding.classes if len(each) > 1])

    def others(name: str) -> str:
        alike = next((each for each in finding.classes if name in each), ())
        return ", ".join(title_of(each) for each in alike if each != name)

    columns = {
        "effect": list(own),
        "title": [title_of(name) for name in own],
        "parameter": [each.name for each in own.values()],
        "detectable": [finding.detectable.get(name) for name in own],
        "unit": [each.unit for each in own.values()],
        "needed_d": [finding.needed_d.get(name) for name in own],
        "class": [others(name) for name in own],
    }
    shares = [(name, _of_typical(each, finding.detectable.get(name))) for name, each in own.items()]
    data = draft.data("detectable", columns, {"parameter": "by its"})
    draft.figure("detectable", figures.detectable_figure(shares), data)
    return draft.section()


def _of_typical(own: Parameter, least: float | None) -> float | None:
    """The least size that shows over the effect's typical one."""
    typical = abs(own.typical - own.null) if np.isfinite(own.null) else abs(own.typical)
    return None if least is None or typical == 0.0 else least / typical


def _evidence(closed: Closed) -> Section:
    finding = closed.finding
    tried, base = finding.evidences, finding.evidences[0].log_evidence
    draft = prose("evidence", tried=tried)
    columns: dict[str, list[Any]] = {
        "model": [names_of(each.effects) for each in tried],
        "effects": [", ".join(each.effects) for each in tried],
        "log_evidence": [each.log_evidence - base for each in tried],
        **_attributes(tried, "left_p_value", "why_not"),
    }
    unlisted = (f"no effect: {finding.shape}", "", finding.unlisted - base, None, "")
    for values, last in zip(columns.values(), unlisted, strict=True):
        values.append(last)
    drawn = figures.evidence_figure(tried, finding.unlisted)
    draft.figure("evidence", drawn, draft.data("evidence", columns))
    return draft.section()


def _attribution(closed: Closed) -> Section:
    finding = closed.finding
    draft = prose("attribution", finding=finding, opening=opening(finding))
    parameters = {
        "parameter": list(finding.parameters),
        **_attributes(list(finding.parameters.values()), "estimate", "low", "high", "unit"),
    }
    draft.table("parameters", parameters)
    weights = {
        "effect": finding.effects,
        "title": map(title_of, finding.effects),
        "weight": [float(finding.weights[each]) for each in finding.effects],
        "probability": [finding.probabilities.get(each) for each in finding.effects],
    }
    drawn = figures.weights_figure(finding) if finding.effects else None
    draft.figure("weights", drawn, draft.data("weights", weights))
    seen = _directions(closed, finding.model, tuple(finding.theta))
    draft.table("refit_directions", seen)
    return draft.section()


def _left(closed: Closed) -> Section:
    finding = closed.finding
    draft = prose("left", p_value=finding.open_set_p_value)
    before, after = (np.sort(x[finding.rows]) for x in closed.left)
    expected = ndtri((np.arange(len(before)) + 0.5) / len(before))
    sorted_left = {"normal": expected, "before": before, "after": after}
    drawn = figures.left_figure(expected, before, after)
    draft.figure("left", drawn, draft.data("quantiles", sorted_left, SIGMA))
    draft.table("tests_after", _tested(finding.tests_after))
    return draft.section()


def held_out_section(closed: Closed) -> Section:
    """Errors on what took no part, with what was predicted of it."""
    held = closed.finding.held_out
    draft = prose("held_out", "held-out", held=held)
    _errors(closed, draft)
    values = _values(closed, held, "before", "after", "low", "high")
    words = {"measured": "measured", "before": "before", "after": "after"}
    heads = _in_unit(closed, **words, low="90 % from", high="to")
    drawn = figures.held_figure(held, quantity_of(closed), values["group"]) if held else None
    draft.figure("held-out", drawn, draft.data("held_out", values, heads))
    return draft.section()


def _values(closed: Closed, predicted: HeldOut | Solid | None, *names: str) -> dict[str, Any]:
    """Columns of held-out values and what is predicted of them, empty where that is None."""
    if predicted is None:
        return dict.fromkeys(("group", "measured", *names), ())
    own = {name: getattr(predicted, name) for name in names}
    group = closed.problem.group[predicted.rows]
    return {"group": group, "measured": predicted.values, **own}


def _errors(closed: Closed, draft: Draft) -> None:
    """Errors before and after, by the fast model and by the 3-D one."""
    models = {"as fitted": closed.finding.held_out, "3-D": closed.confirmation.solid}
    found = {name: each for name, each in models.items() if each is not None}
    names = ("rms_before", "rms_after", "reduction_low", "reduction_high", "coverage_90")
    unit = closed.problem.unit
    columns: dict[str, list[Any]] = {"model": list(found)}
    columns |= {name: [getattr(each, name, None) for each in found.values()] for name in names}
    heads: dict[str, Head] = {f"rms_{at}": (f"rms {at}", unit) for at in ("before", "after")}
    draft.table("errors", columns, heads)


def _solid(closed: Closed) -> Section:
    confirmation = closed.confirmation
    solid = confirmation.solid
    draft = prose("solid", solid=solid, why=confirmation.why)
    values = _values(closed, solid, "before", "after")
    heads = _in_unit(closed, measured="measured", before="3-D before", after="3-D after")
    drawn = figures.solid_figure(solid, quantity_of(closed)) if solid else None
    draft.figure("solid", drawn, draft.data("solid", values, heads))
    return draft.section()


def _next(closed: Closed) -> Section:
    finding = closed.finding
    asked = [] if finding.next_experiment is None else [finding.next_experiment]
    draft = prose("next", finding=finding)
    columns = {
        "change": [each.change for each in asked],
        "separates": [", ".join(each.separates) for each in asked],
        "expected_gain": [each.expected_gain for each in asked],
    }
    draft.table("next_experiment", columns)
    return draft.section()


SECTIONS = (
    *(_noise, _baseline, _residuals, _tests, _detectable, _evidence, _attribution, _left),
    *(held_out_section, _solid, _next),
)
