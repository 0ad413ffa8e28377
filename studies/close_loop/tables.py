"""Tables behind the page of a closed loop.

Every run writes the same set, so that no table of an earlier run stays beside a new page.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...solver.arrays import Array
from ...solver.effects.base import Parameter
from ..loop.finding import Finding, Test
from ..report.page import Column, Columns, Table
from .directions import Direction
from .rows import Rows, names_of, title_of

GROUP = Column("group", "Drop, fall or pass")


def noise_table(rows: Rows) -> Table:
    """The standard deviation taken for each quantity, and the noise that the data chose."""
    problem, noise = rows.closed.problem, rows.closed.finding.noise
    names = list(dict.fromkeys(map(str, problem.quantity)))
    own = [problem.quantity == name for name in names]
    sigma = problem.scale / rows.unit
    columns: Columns = {
        Column("quantity", "Quantity"): names,
        Column("values", "Values"): [int(mine.sum()) for mine in own],
        Column("sigma", "Standard deviation", digits=3): [
            float(np.median(sigma[mine])) for mine in own
        ],
        Column("unit", "in"): [problem.unit, *[""] * (len(names) - 1)],
        Column("shape", "Shape chosen"): [noise["shape"]] * len(names),
        Column("core", "Core over it", digits=3): [noise["scale"]] * len(names),
        Column("correlation", "Correlation with the one before", digits=2): (
            [noise["correlation"]] * len(names)
        ),
    }
    note = "A quantity of another unit has its unit in its name."
    return Table.of("noise", "Noise of the values.", columns, note)


def histogram_table(before: Array, after: Array, bins: Array) -> Table:
    """Counts of residuals by bin."""
    counts = [np.histogram(np.clip(x, bins[0], bins[-1]), bins)[0] for x in (before, after)]
    columns: Columns = {
        Column("from_sigma", "from", "σ"): bins[:-1],
        Column("to_sigma", "to", "σ"): bins[1:],
        Column("before", "before"): counts[0],
        Column("after", "after"): counts[1],
    }
    return Table.of("residual_histogram", "Residuals by size.", columns)


def fit_table(rows: Rows) -> Table:
    """Every value of the main quantity, and both models' predictions."""
    problem, mine, unit = rows.closed.problem, rows.main, rows.closed.problem.unit
    columns: Columns = {
        GROUP: problem.group[mine],
        **{Column(c.name, c.label, c.unit): x[mine] for c, x in rows.covariates},
        Column("measured", "measured", unit, 5): rows.measured(problem.values)[mine],
        Column("before", "baseline", unit, 5): rows.measured(rows.before)[mine],
        Column("after", "with what was found", unit, 5): rows.measured(rows.after)[mine],
        Column("held_out", "held out"): rows.held[mine],
    }
    return Table.of("fit", "Measured and predicted.", columns)


def residual_table(rows: Rows) -> Table:
    """Residuals of every row in standard deviations."""
    columns: Columns = {
        GROUP: rows.closed.problem.group,
        Column("quantity", "Quantity"): rows.closed.problem.quantity,
        **{Column(c.name, c.label, c.unit): x for c, x in rows.covariates},
        Column("before", "before", "σ"): rows.left_before,
        Column("after", "after", "σ"): rows.left_after,
        Column("held_out", "held out"): rows.held,
    }
    return Table.of("residuals", "Residuals in standard deviations.", columns)


def baseline_table(parameters: Sequence[Parameter], theta: Sequence[float]) -> Table:
    """The baseline's free parameters at their best fit."""
    columns: Columns = {
        Column("parameter", "Parameter"): [each.name for each in parameters],
        Column("estimate", "best fit"): np.asarray(theta),
        Column("unit", "unit"): [each.unit for each in parameters],
        Column("low", "bounded from"): [each.low for each in parameters],
        Column("high", "to"): [each.high for each in parameters],
        Column("why", "why these bounds"): [each.why for each in parameters],
    }
    return Table.of("baseline", "The baseline's free parameters.", columns)


def direction_table(
    name: str, caption: str, parameters: Sequence[Parameter], found: Sequence[Direction]
) -> Table:
    """Directions among parameters, and how well the data tell them."""
    names = [each.name for each in parameters]
    columns: Columns = {
        Column("direction", "Direction (shares of each parameter's range)"): [
            each.words(names) for each in found
        ],
        Column("deviation", "standard deviation over the range", digits=2): [
            each.deviation for each in found
        ],
        Column("seen", "the data see it"): [each.seen for each in found],
    }
    note = "A range that says nothing has a standard deviation of 0.29."
    return Table.of(name, caption, columns, note)


def test_table(name: str, caption: str, tests: Sequence[Test]) -> Table:
    """Tests with their values and p-values alone."""
    columns: Columns = {
        Column("test", "Test"): [each.name for each in tests],
        Column("value", "value"): [each.value for each in tests],
        Column("p_value", "p alone", digits=2): [each.p_value for each in tests],
    }
    return Table.of(name, caption, columns, "p-values by simulation, each test by itself.")


def _own_parameters(rows: Rows) -> dict[str, Parameter]:
    """The first parameter of each effect, by its name."""
    problem = rows.closed.problem
    base = len(problem.baseline.parameters)
    return {each.effects[0]: each.parameters[base] for each in problem.candidates}


def detectable_table(rows: Rows) -> Table:
    """From which size on effects would show, and which cannot be told apart."""
    finding, own = rows.closed.finding, _own_parameters(rows)

    def others(name: str) -> str:
        alike = next((each for each in finding.classes if name in each), ())
        return ", ".join(title_of(each) for each in alike if each != name)

    columns: Columns = {
        Column("effect", "Effect"): list(own),
        Column("title", "in words"): [title_of(name) for name in own],
        Column("parameter", "by its"): [each.name for each in own.values()],
        Column("detectable", "shows from", digits=3): [finding.detectable.get(n) for n in own],
        Column("unit", "unit"): [each.unit for each in own.values()],
        Column("needed_d", "that is, in σ", digits=3): [finding.needed_d.get(n) for n in own],
        Column("class", "cannot be told from"): [others(name) for name in own],
    }
    note = (
        "Shows: is detected nine times in ten. A dash: at no size within its bounds, or only "
        "together with another effect."
    )
    return Table.of("detectable", "What these data could show.", columns, note)


def shares_of_typical(rows: Rows) -> list[tuple[str, float | None]]:
    """The least size that shows over the effect's typical one, by effect."""
    out = []
    for name, own in _own_parameters(rows).items():
        least = rows.closed.finding.detectable.get(name)
        typical = abs(own.typical - own.null) if np.isfinite(own.null) else abs(own.typical)
        share = None if least is None or typical == 0.0 else least / typical
        out.append((name, share))
    return out


def evidence_table(finding: Finding) -> Table:
    """Every model that was refitted, and the likeliest shape that no effect has."""
    base, tried = finding.evidences[0].log_evidence, finding.evidences
    columns: Columns = {
        Column("model", "Model"): [
            *(names_of(each.effects) for each in tried),
            f"no effect: {finding.shape}",
        ],
        Column("effects", "effects"): [*(", ".join(each.effects) for each in tried), ""],
        Column("log_evidence", "log evidence over the baseline's", "nats"): [
            *(each.log_evidence - base for each in tried),
            finding.unlisted - base,
        ],
        Column("left_p_value", "p of what it leaves", digits=2): [
            *(each.left_p_value for each in tried),
            None,
        ],
        Column("why_not", "why it does not hold"): [*(each.why_not for each in tried), ""],
    }
    return Table.of("evidence", "Models tried.", columns, "A dash: not asked.")


def weight_table(finding: Finding) -> Table:
    """The verdict's effects with their probabilities."""
    columns: Columns = {
        Column("effect", "Effect"): finding.effects,
        Column("title", "in words"): map(title_of, finding.effects),
        Column("weight", "probability"): [float(finding.weights[each]) for each in finding.effects],
    }
    return Table.of("weights", "The verdict's effects, likeliest first.", columns)


def parameter_table(finding: Finding) -> Table:
    """Parameters of the reported model."""
    found = finding.parameters
    columns: Columns = {
        Column("parameter", "Parameter"): list(found),
        Column("estimate", "estimate"): [each.estimate for each in found.values()],
        Column("low", "90 % from"): [each.low for each in found.values()],
        Column("high", "to"): [each.high for each in found.values()],
        Column("unit", "unit"): [each.unit for each in found.values()],
    }
    return Table.of("parameters", "Parameters of the refitted model.", columns)


def quantile_table(expected: Array, before: Array, after: Array) -> Table:
    """Sorted residuals beside normal quantiles."""
    columns: Columns = {
        Column("normal", "normal quantile", "σ"): expected,
        Column("before", "before", "σ"): before,
        Column("after", "after", "σ"): after,
    }
    return Table.of("quantiles", "Sorted residuals of the fitted rows.", columns)


def held_table(rows: Rows) -> Table:
    """Held-out values with predictions and intervals."""
    held, problem = rows.closed.finding.held_out, rows.closed.problem
    unit = problem.unit
    columns: Columns = {
        GROUP: problem.group[held.rows] if held else (),
        Column("measured", "measured", unit, 5): held.values if held else (),
        Column("before", "before", unit, 5): held.before if held else (),
        Column("after", "after", unit, 5): held.after if held else (),
        Column("low", "90 % from", unit, 5): held.low if held else (),
        Column("high", "to", unit, 5): held.high if held else (),
    }
    return Table.of("held_out", "Never used in fitting or choosing.", columns)


def error_table(rows: Rows) -> Table:
    """Errors before and after, by the fast model and by the 3-D one."""
    held, solid = rows.closed.finding.held_out, rows.closed.confirmation.solid
    unit = rows.closed.problem.unit
    models = {"as fitted": held, "3-D": solid}
    found = {name: each for name, each in models.items() if each is not None}

    def by_fit(name: str) -> list[float | None]:
        """What is known of the fast model alone."""
        return [getattr(each, name, None) for each in found.values()]

    columns: Columns = {
        Column("model", "Model"): list(found),
        Column("rms_before", "rms before", unit): [each.rms_before for each in found.values()],
        Column("rms_after", "rms after", unit): [each.rms_after for each in found.values()],
        Column("reduction_low", "less by, 90 % from", digits=3): by_fit("reduction_low"),
        Column("reduction_high", "to", digits=3): by_fit("reduction_high"),
        Column("coverage_90", "within their 90 % interval", digits=3): by_fit("coverage_90"),
    }
    return Table.of("errors", "Error on held-out data.", columns)


def solid_table(rows: Rows) -> Table:
    """Held-out values and what the 3-D model predicts of them."""
    solid, problem = rows.closed.confirmation.solid, rows.closed.problem
    unit = problem.unit
    columns: Columns = {
        GROUP: problem.group[solid.rows] if solid else (),
        Column("measured", "measured", unit, 5): solid.values if solid else (),
        Column("before", "3-D before", unit, 5): solid.before if solid else (),
        Column("after", "3-D after", unit, 5): solid.after if solid else (),
    }
    return Table.of("solid", "The 3-D model on held-out data.", columns)


def next_table(finding: Finding) -> Table:
    """What to measure next."""
    asked = [] if finding.next_experiment is None else [finding.next_experiment]
    columns: Columns = {
        Column("change", "Measure"): [each.change for each in asked],
        Column("separates", "separates"): [", ".join(each.separates) for each in asked],
        Column("expected_gain", "expected gain", "nats"): [each.expected_gain for each in asked],
    }
    return Table.of("next_experiment", "The next experiment.", columns)
