"""Tables behind the page of a closed loop.

Every run writes the same set, so that no table of an earlier run stays beside a new page.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...solver.arrays import Array
from ...solver.effects.base import Parameter
from ..loop.finding import Finding, Test
from ..report.page import Column, Table, Value
from .directions import Direction
from .rows import Rows, names_of, title_of


def noise_table(rows: Rows) -> Table:
    """The standard deviation taken for each quantity, and the noise that the data chose."""
    problem, noise = rows.closed.problem, rows.closed.finding.noise
    chosen: list[Value] = [noise["shape"], noise["scale"], noise["correlation"]]
    lines: list[list[Value]] = []
    for name in dict.fromkeys(map(str, problem.quantity)):
        mine = problem.quantity == name
        sigma = float(np.median(problem.scale[mine] / rows.unit[mine]))
        own = problem.unit if name == problem.quantity[0] else ""
        lines.append([name, int(mine.sum()), sigma, own, *chosen])
    head = (
        Column("quantity", "Quantity"),
        Column("values", "Values"),
        Column("sigma", "Standard deviation", digits=3),
        Column("unit", "in"),
        Column("shape", "Shape chosen"),
        Column("core", "Core over it", digits=3),
        Column("correlation", "Correlation with the one before", digits=2),
    )
    note = "A quantity of another unit has its unit in its name."
    return Table("noise", "Noise of the values.", head, lines, note)


def histogram_table(before: Array, after: Array, bins: Array) -> Table:
    """Counts of residuals by bin."""
    counts = [np.histogram(np.clip(x, bins[0], bins[-1]), bins)[0] for x in (before, after)]
    head = (
        Column("from_sigma", "from", "σ"),
        Column("to_sigma", "to", "σ"),
        Column("before", "before"),
        Column("after", "after"),
    )
    lines = [
        (float(a), float(b), int(one), int(two))
        for a, b, one, two in zip(bins[:-1], bins[1:], *counts, strict=True)
    ]
    return Table("residual_histogram", "Residuals by size.", head, lines)


def fit_table(rows: Rows) -> Table:
    """Every value of the main quantity, and both models' predictions."""
    problem, mine = rows.closed.problem, np.flatnonzero(rows.main)
    unit = problem.unit
    columns = [
        Column("group", "Drop, fall or pass"),
        *(Column(c.name, c.label, c.unit) for c, _ in rows.covariates),
        Column("measured", "measured", unit, 5),
        Column("before", "baseline", unit, 5),
        Column("after", "with what was found", unit, 5),
        Column("held_out", "held out"),
    ]
    values = [rows.measured(x) for x in (problem.values, rows.before, rows.after)]
    lines = [
        (
            int(problem.group[i]),
            *(float(x[i]) for _, x in rows.covariates),
            *(float(x[i]) for x in values),
            bool(rows.held[i]),
        )
        for i in mine
    ]
    return Table("fit", "Measured and predicted.", tuple(columns), lines)


def residual_table(rows: Rows) -> Table:
    """Residuals of every row in standard deviations."""
    problem = rows.closed.problem
    before, after = rows.left_before, rows.left_after
    columns = (
        Column("group", "Drop, fall or pass"),
        Column("quantity", "Quantity"),
        *(Column(c.name, c.label, c.unit) for c, _ in rows.covariates),
        Column("before", "before", "σ"),
        Column("after", "after", "σ"),
        Column("held_out", "held out"),
    )
    lines: list[tuple[Value, ...]] = [
        (
            int(problem.group[i]),
            str(problem.quantity[i]),
            *(float(x[i]) for _, x in rows.covariates),
            float(before[i]),
            float(after[i]),
            bool(rows.held[i]),
        )
        for i in range(len(problem.values))
    ]
    return Table("residuals", "Residuals in standard deviations.", columns, lines)


def baseline_table(parameters: Sequence[Parameter], theta: Sequence[float]) -> Table:
    """The baseline's free parameters at their best fit."""
    head = (
        Column("parameter", "Parameter"),
        Column("estimate", "best fit"),
        Column("unit", "unit"),
        Column("low", "bounded from"),
        Column("high", "to"),
        Column("why", "why these bounds"),
    )
    lines = [
        (each.name, float(x), each.unit, each.low, each.high, each.why)
        for each, x in zip(parameters, theta, strict=True)
    ]
    return Table("baseline", "The baseline's free parameters.", head, lines)


def direction_table(
    name: str, caption: str, parameters: Sequence[Parameter], found: Sequence[Direction]
) -> Table:
    """Directions among parameters, and how well the data tell them."""
    names = [each.name for each in parameters]
    head = (
        Column("direction", "Direction (shares of each parameter's range)"),
        Column("deviation", "standard deviation over the range", digits=2),
        Column("seen", "the data see it"),
    )
    lines = [(each.words(names), each.deviation, each.seen) for each in found]
    note = "A range that says nothing has a standard deviation of 0.29."
    return Table(name, caption, head, lines, note)


def test_table(name: str, caption: str, tests: Sequence[Test]) -> Table:
    """Tests with their values and p-values alone."""
    head = (
        Column("test", "Test"),
        Column("value", "value"),
        Column("p_value", "p alone", digits=2),
    )
    lines = [(each.name, each.value, each.p_value) for each in tests]
    return Table(name, caption, head, lines, "p-values by simulation, each test by itself.")


def detectable_table(rows: Rows) -> Table:
    """From which size on effects would show, and which cannot be told apart."""
    finding, problem = rows.closed.finding, rows.closed.problem
    base = len(problem.baseline.parameters)
    lines: list[list[Value]] = []
    for model in problem.candidates:
        name, own = model.effects[0], model.parameters[base]
        alike = next((c for c in finding.classes if name in c), ())
        least = finding.detectable.get(name)
        needed = finding.needed_d.get(name)
        others = ", ".join(title_of(each) for each in alike if each != name)
        lines.append([name, title_of(name), own.name, least, own.unit, needed, others])
    head = (
        Column("effect", "Effect"),
        Column("title", "in words"),
        Column("parameter", "by its"),
        Column("detectable", "shows from", digits=3),
        Column("unit", "unit"),
        Column("needed_d", "that is, in σ", digits=3),
        Column("class", "cannot be told from"),
    )
    note = (
        "Shows: is detected nine times in ten. A dash: at no size within its bounds, or only "
        "together with another effect."
    )
    return Table("detectable", "What these data could show.", head, lines, note)


def shares_of_typical(rows: Rows) -> list[tuple[str, float | None]]:
    """The least size that shows over the effect's typical one, by effect."""
    finding, problem = rows.closed.finding, rows.closed.problem
    base = len(problem.baseline.parameters)
    out = []
    for model in problem.candidates:
        name, own = model.effects[0], model.parameters[base]
        least = finding.detectable.get(name)
        typical = abs(own.typical - own.null) if np.isfinite(own.null) else abs(own.typical)
        share = None if least is None or typical == 0.0 else least / typical
        out.append((name, share))
    return out


def evidence_table(finding: Finding) -> Table:
    """Every model that was refitted."""
    base = finding.evidences[0].log_evidence
    head = (
        Column("model", "Model"),
        Column("effects", "effects"),
        Column("log_evidence", "log evidence over the baseline's", "nats"),
        Column("left_p_value", "p of what it leaves", digits=2),
        Column("why_not", "why it does not hold"),
    )
    lines: list[Sequence[Value]] = [
        (
            names_of(each.effects),
            ", ".join(each.effects),
            each.log_evidence - base,
            each.left_p_value,
            each.why_not,
        )
        for each in finding.evidences
    ]
    shape = f"no effect: {finding.shape}"
    lines.append((shape, "", finding.unlisted - base, None, ""))
    return Table("evidence", "Models tried.", head, lines, "A dash: not asked.")


def weight_table(finding: Finding) -> Table:
    """The verdict's effects with their probabilities."""
    head = (
        Column("effect", "Effect"),
        Column("title", "in words"),
        Column("weight", "probability"),
    )
    lines = [(name, title_of(name), float(finding.weights[name])) for name in finding.effects]
    return Table("weights", "The verdict's effects, likeliest first.", head, lines)


def parameter_table(finding: Finding) -> Table:
    """Parameters of the reported model."""
    head = (
        Column("parameter", "Parameter"),
        Column("estimate", "estimate"),
        Column("low", "90 % from"),
        Column("high", "to"),
        Column("unit", "unit"),
    )
    lines = [(n, x.estimate, x.low, x.high, x.unit) for n, x in finding.parameters.items()]
    return Table("parameters", "Parameters of the refitted model.", head, lines)


def quantile_table(expected: Array, before: Array, after: Array) -> Table:
    """Sorted residuals beside normal quantiles."""
    head = (
        Column("normal", "normal quantile", "σ"),
        Column("before", "before", "σ"),
        Column("after", "after", "σ"),
    )
    lines = [tuple(map(float, each)) for each in zip(expected, before, after, strict=True)]
    return Table("quantiles", "Sorted residuals of the fitted rows.", head, lines)


def held_table(rows: Rows) -> Table:
    """Held-out values with predictions and intervals."""
    held, problem = rows.closed.finding.held_out, rows.closed.problem
    unit = problem.unit
    head = (
        Column("group", "Drop, fall or pass"),
        Column("measured", "measured", unit, 5),
        Column("before", "before", unit, 5),
        Column("after", "after", unit, 5),
        Column("low", "90 % from", unit, 5),
        Column("high", "to", unit, 5),
    )
    lines: list[tuple[Value, ...]] = []
    if held is not None:
        columns = (held.values, held.before, held.after, held.low, held.high)
        lines = [
            (int(problem.group[row]), *(float(x[i]) for x in columns))
            for i, row in enumerate(held.rows)
        ]
    return Table("held_out", "Never used in fitting or choosing.", head, lines)


def error_table(rows: Rows) -> Table:
    """Errors before and after, by the fast model and by the 3-D one."""
    held, solid = rows.closed.finding.held_out, rows.closed.confirmation.solid
    unit = rows.closed.problem.unit
    head = (
        Column("model", "Model"),
        Column("rms_before", "rms before", unit),
        Column("rms_after", "rms after", unit),
        Column("reduction_low", "less by, 90 % from", digits=3),
        Column("reduction_high", "to", digits=3),
        Column("coverage_90", "within their 90 % interval", digits=3),
    )
    lines: list[tuple[Value, ...]] = []
    if held is not None:
        shares = (held.reduction_low, held.reduction_high, held.coverage_90)
        lines.append(("as fitted", held.rms_before, held.rms_after, *shares))
    if solid is not None:
        lines.append(("3-D", solid.rms_before, solid.rms_after, None, None, None))
    return Table("errors", "Error on held-out data.", head, lines)


def solid_table(rows: Rows) -> Table:
    """Held-out values and what the 3-D model predicts of them."""
    solid, problem = rows.closed.confirmation.solid, rows.closed.problem
    unit = problem.unit
    head = (
        Column("group", "Drop, fall or pass"),
        Column("measured", "measured", unit, 5),
        Column("before", "3-D before", unit, 5),
        Column("after", "3-D after", unit, 5),
    )
    lines: list[tuple[Value, ...]] = []
    if solid is not None:
        lines = [
            (int(problem.group[row]), float(y), float(one), float(two))
            for row, y, one, two in zip(
                solid.rows, solid.values, solid.before, solid.after, strict=True
            )
        ]
    return Table("solid", "The 3-D model on held-out data.", head, lines)


def next_table(finding: Finding) -> Table:
    """What to measure next."""
    head = (
        Column("change", "Measure"),
        Column("separates", "separates"),
        Column("expected_gain", "expected gain", "nats"),
    )
    each = finding.next_experiment
    lines = []
    if each is not None:
        lines = [(each.change, ", ".join(each.separates), float(each.expected_gain))]
    return Table("next_experiment", "The next experiment.", head, lines)
