"""Page of a closed loop, step by step."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtri

from ..inputs.again import into
from ..loop.finding import Verdict
from ..report.figures import picture
from ..report.page import Figure, Report, Section, Table, percent, show, write_report
from ..running.files import remove
from . import figures, tables
from .directions import Direction, directions
from .rows import Rows, names_of, title_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

    from .run import Closed

BINS = np.linspace(-6.0, 6.0, 33)
SOMETIMES = ("weights", "held-out", "solid")
ALWAYS = "The held-out groups were chosen by the seed before anything was fitted."


def write_page(closed: Closed, out: Path, version: str) -> Path:
    """Write ``report.html``, ``tables/`` and ``figures/`` into ``out``; returns the page's path."""
    page = page_of(closed, out, version)
    path = write_report(page, out)
    drawn = {figure.name for section in page.sections for figure in section.figures}
    for name in set(SOMETIMES) - drawn:  # of an earlier run
        for ending in (".svg", ".png"):
            remove(out / "figures" / f"{name}{ending}")
    return path


def page_of(closed: Closed, out: Path, version: str) -> Report:
    """The page: each step of the loop a section."""
    rows, manifest = Rows(closed), closed.manifest
    facts = [
        ("Dataset", manifest.title),
        ("Kind", manifest.kind),
        ("Values", f"{len(rows.main)} in {len(np.unique(closed.problem.group))} groups"),
        ("Source", manifest.source or "not declared"),
        ("Licence of the data", manifest.licence or "not declared"),
        ("Seed", str(closed.inputs.seed)),
        ("False-alarm rate", percent(closed.inputs.alarm, 1)),
    ]
    return Report(
        title=f"What the model lacks: {manifest.title}",
        lead="From measured data the model is fitted, what it leaves is traced to an effect that "
        "it lacks, and the error is told before and after on data that took no part.",
        version=version,
        command=_command(closed, out),
        headline=headline(closed),
        facts=facts,
        sections=[
            _noise(rows),
            _baseline(rows),
            _residuals(rows),
            _tests(rows),
            _detectable(rows),
            _evidence(rows),
            _attribution(rows),
            _left(rows),
            held_out_section(rows),
            _solid(rows),
            _next(rows),
        ],
    )


def _command(closed: Closed, out: Path) -> str:
    asked = closed.inputs
    options = ["--seed", asked.seed, "--alarm", f"{asked.alarm:g}"]
    options += ["--no-3d"] if asked.no_3d else []
    return into(out, "close-loop", closed.manifest.folder, *options)


def headline(closed: Closed) -> list[str]:
    """The verdict and what it is worth, in a few sentences."""
    finding = closed.finding
    held, solid = finding.held_out, closed.confirmation.solid
    sentences = [verdict_words(closed)]
    if held is not None and finding.model_effects:
        low, high = (percent(x, 0) for x in (held.reduction_low, held.reduction_high))
        sentences.append(
            f"Error on held-out data: {show(held.rms_before, 3)} {held.unit} before, "
            f"{show(held.rms_after, 3)} {held.unit} after; less by {low} to {high} "
            f"(90 % interval). Their noise leaves {show(held.sigma, 3)} {held.unit}."
        )
    if solid is not None and finding.model_effects:
        sentences.append(
            f"The 3-D model with the same in it: {show(solid.rms_before, 3)} {solid.unit} before, "
            f"{show(solid.rms_after, 3)} {solid.unit} after."
        )
    if finding.next_experiment is not None:
        sentences.append(f"To separate them: {finding.next_experiment.change}.")
    sentences += [f"Doubt: {warning}." for warning in finding.all_warnings()]
    return sentences + [f"Left aside: {each}." for each in finding.left_aside]


def verdict_words(closed: Closed) -> str:
    """The verdict as a sentence."""
    finding = closed.finding
    p = show(finding.p_value, 2)
    if finding.verdict is Verdict.ADEQUATE:
        return (
            f"Adequate: nothing is missing that these data could show (p = {p} over all tests). "
            "What they could not show is listed below."
        )
    if finding.verdict is Verdict.UNKNOWN:
        near = finding.nearest
        nearest = "" if near is None else f" {near.words()}, but {near.why_not}."
        return f"Unknown: something is missing (p = {p}), and no known effect explains it.{nearest}"
    if finding.verdict is Verdict.EFFECT:
        return f"The model lacks: {names_of(finding.effects)} (p = {p} that nothing is missing)."
    several = "; ".join(title_of(name) for name in finding.effects)
    return f"Ambiguous: something is missing (p = {p}); each of these explains it: {several}."


def _figure(name: str, caption: str, drawn: Drawing, alt: str, data: Table) -> Figure:
    return Figure(name, caption, picture(drawn), alt, data)


def _quantity(rows: Rows) -> str:
    problem = rows.closed.problem
    name = str(problem.quantity[0])
    return name if "(" in name else f"{name} ({problem.unit})"


def _noise(rows: Rows) -> Section:
    problem, finding = rows.closed.problem, rows.closed.finding
    before, after = rows.left_before, rows.left_after
    declared = (
        "Values are compared in units of their declared or measured standard deviation."
        if problem.sigma_declared
        else "The dataset declares no uncertainty: it is taken from repeats at the same height, "
        "else from differences of neighbours."
    )
    text = [
        declared + " Tails, outliers, a standard deviation declared too small and correlation from "
        "one value to the next would each look like an effect; so each is a hypothesis that every "
        "model may choose, within bounds: noise may be odd or somewhat larger than declared, and "
        "what is both is something that the model lacks.",
        f"Most likely under the reported model: {finding.noise['shape']}, "
        f"{show(_number(finding.noise['scale']), 3)} of the standard deviation, correlation "
        f"{show(_number(finding.noise['correlation']), 2)}.",
        *(f"{name}: {words}" for name, words in problem.notes.items() if isinstance(words, str)),
    ]
    drawn = _figure(
        "noise",
        "Residuals in standard deviations, before (orange) and after (blue).",
        figures.noise_figure(before, after, BINS),
        "Histogram of residuals before and after with the normal density",
        tables.histogram_table(before, after, BINS),
    )
    return Section("noise", "Noise", text, figures=[drawn], tables=[tables.noise_table(rows)])


def _number(value: float | str) -> float | str:
    return float(value)


def _baseline(rows: Rows) -> Section:
    problem, finding = rows.closed.problem, rows.closed.finding
    theta = finding.evidences[0].theta
    parameters = problem.baseline.parameters
    first = directions(problem.baseline, theta, finding.rows, rows.unit)
    names = [each.name for each in parameters]
    text = [
        "The model as it is, without any effect, at the parameters that fit best. "
        + _unseen_words(first, names),
    ]
    quantity = _quantity(rows)
    drawn = _figure(
        "baseline",
        "Measured values and the fitted baseline's.",
        figures.fit_figure(rows, quantity),
        f"{quantity}, measured and predicted by the baseline",
        tables.fit_table(rows),
    )
    return Section(
        "baseline",
        "Baseline fit",
        text,
        figures=[drawn],
        tables=[
            tables.baseline_table(parameters, theta),
            tables.direction_table(
                "baseline_directions", "Directions that the data see.", parameters, first
            ),
        ],
    )


def _unseen_words(found: list[Direction], names: list[str]) -> str:
    unseen = [each.words(names) for each in found if not each.seen]
    if not unseen:
        return "The data see every direction among its parameters."
    return f"Directions that the data cannot identify: {'; '.join(unseen)}."


def _residuals(rows: Rows) -> Section:
    against = ", ".join(covariate.label for covariate, _ in rows.covariates)
    text = [
        f"What the fitted baseline leaves (left) and what is left with what was found in it "
        f"(right), against {against}; the band is ±2 standard deviations. Held-out values are "
        "among them. Where an effect differs by chance, a value stands at the normal quantile that "
        "it has among all that the model predicts.",
    ]
    drawn = _figure(
        "residuals",
        "Residuals against every covariate, before and after.",
        figures.residual_figure(rows),
        f"Residuals against {against}",
        tables.residual_table(rows),
    )
    return Section("residuals", "Residuals against every covariate", text, figures=[drawn])


def _tests(rows: Rows) -> Section:
    finding = rows.closed.finding
    missing = finding.p_value <= finding.alarm
    text = [
        f"All tests were named before the data were seen. One rate holds for all of them together: "
        f"data that lack nothing are said to lack something {percent(finding.alarm, 1)} of the "
        f"time. The least p-value is that of '{finding.statistic}'; corrected for every test made, "
        f"p = {show(finding.p_value, 2)}: {'something is' if missing else 'nothing seems'} "
        "missing.",
        "p-values come from noise of bounded size, drawn and refitted like the data.",
    ]
    drawn = _figure(
        "tests",
        "Each test alone, before and after.",
        figures.tests_figure(finding.tests, finding.tests_after, finding.p_value),
        "p-values of all tests before and after",
        tables.test_table("tests", "Tests of the baseline.", finding.tests),
    )
    return Section("tests", "Is something missing?", text, figures=[drawn])


def _detectable(rows: Rows) -> Section:
    finding = rows.closed.finding
    groups = [" = ".join(map(title_of, each)) for each in finding.classes if len(each) > 1]
    text = [
        "Whatever the verdict, these data can show an effect only from some size on, after all "
        "that a fit absorbs is taken off.",
        f"Effects that these data cannot tell apart: {'; '.join(groups)}."
        if groups
        else "No two effects look alike to these data, where they show at all.",
    ]
    drawn = _figure(
        "detectable",
        "Least size that is detected nine times in ten, over a typical size of the effect.",
        figures.detectable_figure(tables.shares_of_typical(rows)),
        "Detectable size of each effect",
        tables.detectable_table(rows),
    )
    return Section("detectable", "What these data could show", text, figures=[drawn])


def _evidence(rows: Rows) -> Section:
    finding = rows.closed.finding
    text = [
        "Each effect is put into the model and all parameters are fitted again; log evidence "
        "weighs fit against freedom. Bands, steps, classes and waves that no effect has compete "
        "with them. The likeliest are held against what they leave and against the held-out data; "
        "the table says why those that do not hold fail.",
    ]
    if len(finding.evidences) == 1:
        text.append("No candidate was refitted: nothing asked for one.")
    drawn = _figure(
        "evidence",
        "Log evidence of the models tried over the baseline's.",
        figures.evidence_figure(finding.evidences, finding.unlisted),
        "Log evidence of each model tried",
        tables.evidence_table(finding),
    )
    return Section("evidence", "Evidence of the candidates", text, figures=[drawn])


def _attribution(rows: Rows) -> Section:
    closed, finding = rows.closed, rows.closed.finding
    text = [verdict_words(closed)]
    for together in finding.together:
        text.append(f"Together, since neither explains it alone: {names_of(together)}.")
    if finding.unidentified:
        text.append(f"Not identified in the refit: {', '.join(finding.unidentified)}.")
    drawn = []
    weights = tables.weight_table(finding)
    if finding.effects:
        drawn.append(
            _figure(
                "weights",
                "Probability of each effect of the verdict.",
                figures.weights_figure(finding),
                "Probabilities of the effects",
                weights,
            )
        )
    model = finding.model
    found = directions(model, tuple(finding.theta), finding.rows, rows.unit)
    caption = "Directions of the refitted model that the data see."
    return Section(
        "attribution",
        "Attribution",
        text,
        figures=drawn,
        tables=[
            tables.parameter_table(finding),
            *([] if drawn else [weights]),
            tables.direction_table("refit_directions", caption, model.parameters, found),
        ],
    )


def _left(rows: Rows) -> Section:
    finding = rows.closed.finding
    p = finding.open_set_p_value
    text = [
        f"The same tests again after the best refit: p = {show(p, 2)} over all of them.",
        "Sorted residuals of the fitted rows against normal quantiles: on the line nothing is left "
        "but noise as declared.",
    ]
    before, after = (np.sort(x[finding.rows]) for x in (rows.left_before, rows.left_after))
    expected = ndtri((np.arange(len(before)) + 0.5) / len(before))
    drawn = _figure(
        "left",
        "What is left.",
        figures.left_figure(expected, before, after),
        "Sorted residuals before and after",
        tables.quantile_table(expected, before, after),
    )
    after_tests = tables.test_table(
        "tests_after", "Tests of what the best refit leaves.", finding.tests_after
    )
    return Section("left", "What is left", text, figures=[drawn], tables=[after_tests])


def held_out_section(rows: Rows) -> Section:
    finding, problem = rows.closed.finding, rows.closed.problem
    held = finding.held_out
    title, errors = "Error on held-out data", tables.error_table(rows)
    if held is None:
        text = ["There are too few groups to hold any out."]
        return Section("held-out", title, text, tables=[errors, tables.held_table(rows)])
    groups = ", ".join(map(str, held.groups))
    text = [
        f"{ALWAYS} Held out: {groups}. Rms before {show(held.rms_before, 3)} {held.unit}, after "
        f"{show(held.rms_after, 3)} {held.unit}; {percent(held.coverage_90, 0)} of the held-out "
        "values lie within their 90 % intervals.",
    ]
    labels = [int(problem.group[row]) for row in held.rows]
    drawn = _figure(
        "held-out",
        "What is predicted of held-out values before and after, with 90 % intervals after, less "
        "what was measured.",
        figures.held_figure(held, _quantity(rows), labels),
        "Errors of predictions of held-out values before and after",
        tables.held_table(rows),
    )
    return Section("held-out", title, text, figures=[drawn], tables=[errors])


def _solid(rows: Rows) -> Section:
    confirmation = rows.closed.confirmation
    title, table = "Confirmation in three dimensions", tables.solid_table(rows)
    solid = confirmation.solid
    if solid is None:
        return Section("solid", title, [f"There is none: {confirmation.why}."], tables=[table])
    text = [
        "The 3-D model, with the same parameters and the effect entered through the same object, "
        f"predicts the held-out data: rms {show(solid.rms_before, 3)} {solid.unit} before, "
        f"{show(solid.rms_after, 3)} {solid.unit} after. Nothing was fitted with it.",
    ]
    drawn = _figure(
        "solid",
        "Held-out values and the 3-D model's predictions.",
        figures.solid_figure(solid, _quantity(rows)),
        "Predictions of the 3-D model against measured values",
        table,
    )
    return Section("solid", title, text, figures=[drawn])


def _next(rows: Rows) -> Section:
    finding = rows.closed.finding
    each = finding.next_experiment
    if each is not None:
        sentence = f"Most would be gained from this: {each.change}."
    elif finding.verdict is Verdict.AMBIGUOUS:
        sentence = "No measurement is known here that would separate them."
    else:
        sentence = "None is proposed: no effects are tied."
    return Section("next", "The next experiment", [sentence], tables=[tables.next_table(finding)])
