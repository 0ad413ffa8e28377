"""Tables as laboratories hand them in: slips, empty cells, wrong error bars, sessions, heights that
hardly differ. Found as they are, and taken for no effect."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from blind.make import make
from made_drops import QUICK, SIGMA_MM, SIGMA_N, SIGMA_S, write_drops
from scipy.stats import binom

from bristle.solver.effects.library import EFFECTS
from bristle.solver.errors import InputError
from bristle.studies.close_loop.opening import opening
from bristle.studies.data.datasets import read_drops
from bristle.studies.loop.heldout import split
from bristle.studies.loop.kinds.drops import problem as drops_module
from bristle.studies.loop.kinds.drops.bookkeeping import Table, meant, misread
from bristle.studies.loop.kinds.drops.problem import (
    drops_problem,
    order_of,
    read_problem,
)
from bristle.studies.loop.responses.errors import Errors
from bristle.studies.loop.responses.sessions import Partings
from bristle.studies.loop.run import find
from bristle.studies.loop.scatter import Scatter

pytestmark = pytest.mark.serial
HEAD = "[dataset]\ntitle = 'T'\nkind = 'drops'\n\n[measurement]\nsigma_y_mm = 0.3\n"


# --- slips, on tables of a toy that falls in proportion to the height ---------------------------


def toy(rng, n=48, sigma=2.5e-4, noise=None):
    """A table whose y1 is 0.6 of y0, smoothly changed by something that no effect need be."""
    y0 = rng.permutation(np.resize([0.01, 0.02, 0.03, 0.04, 0.05], n)) + 5e-4 * rng.normal(size=n)
    order = np.log1p(np.arange(n)) / math.log(n)
    y1 = 0.6 * y0 * (1.0 + 0.2 * rng.normal() * y0 / 0.05 + 0.1 * rng.normal() * order)
    errors = rng.normal(size=(n, 2)) if noise is None else noise(rng, (n, 2))
    seen = np.round(np.column_stack([y0, y1]) + sigma * errors, 5)
    return table(seen[:, 0], seen[:, 1:], sigma)


def table(y0, values, sigma=2.5e-4):
    return Table(
        number=1 + np.arange(len(y0)),
        y0_m=y0,
        values=values,
        sigma=np.full(values.shape, math.hypot(sigma, 0.6 * sigma)),
        sigma_y0_m=sigma,
        columns=("y1_mm",),
        unit=(1e3,),
        predict=lambda heights: 0.6 * heights[:, None],
    )


def with_slip(made, how, rng):
    """The table with one thing written wrongly in a drop of at least 30 mm, and that drop."""
    y0, values = made.y0_m.copy(), made.values.copy()
    row = int(rng.choice(np.flatnonzero(y0 > 0.028)))
    text = f"{1e3 * values[row, 0]:.2f}"
    if how == "point":
        values[row] *= rng.choice([0.1, 10.0])
    elif how == "missing":
        values[row] = 1e-3 * float(text[1:])
    elif how == "doubled":
        values[row] = 1e-3 * float(text[0] + text)
    elif how == "columns":
        y0[row], values[row, 0] = values[row, 0], y0[row]
    elif how.startswith("y0"):
        y0[row] *= {"y0": 0.1, "y0 tenfold": 10.0}[how]
    elif how == "anything":
        values[row] *= 1.6
    return table(y0, values), row + 1


HOW = ("point", "missing", "doubled", "columns", "y0", "y0 tenfold", "anything")


@pytest.mark.parametrize("how", HOW)
def test_a_slip_is_named_with_its_row(how):
    found = []
    for seed in range(20):
        rng = np.random.default_rng([seed, len(how)])
        wrong, drop = with_slip(toy(rng), how, rng)
        found.append([(each.kind, each.drops) for each in misread(wrong)[0]] == [("slip", (drop,))])
    assert sum(found) >= 18


def test_rows_that_have_changed_places_and_rows_written_twice():
    rng = np.random.default_rng(5)
    made = toy(rng)
    low, high = int(np.argmin(made.y0_m)), int(np.argmax(made.y0_m))
    values = made.values.copy()
    values[[low, high]] = values[[high, low]]
    (entry,), _ = misread(replace(made, values=values))
    assert (entry.kind, set(entry.drops)) == ("exchanged", {low + 1, high + 1})
    y0, values = made.y0_m.copy(), made.values.copy()
    y0[30], values[30] = y0[12], values[12]
    (entry,), _ = misread(replace(made, y0_m=y0, values=values))
    assert (entry.kind, entry.drops) == ("repeated", (13, 31))
    coarse = replace(made, y0_m=np.round(y0, 3), values=np.round(values, 3))
    assert not misread(coarse)[0]  # read to a millimetre, such rows come by chance


def heavy(rng, shape):
    return rng.standard_t(3.0, size=shape) / math.sqrt(3.0)


def outliers(rng, shape):
    return rng.normal(size=shape) * np.where(rng.random(shape) < 0.05, 5.0, 1.0)


@pytest.mark.parametrize("noise", [None, heavy, outliers], ids=["normal", "heavy", "outliers"])
def test_noise_is_seldom_taken_for_a_slip(noise):
    """In one table of a hundred, or three where the noise itself has outliers."""
    count, rate = 150, 0.03 if noise is outliers else 0.01
    found = sum(bool(misread(toy(np.random.default_rng(s), noise=noise))[0]) for s in range(count))
    assert found <= binom.ppf(0.999, count, rate)


@pytest.mark.parametrize("others", [range(1, 42), np.geomspace(1.0, 100.0, 14)])
@pytest.mark.parametrize("high", [1, 2])
def test_a_drop_from_far_above_all_others_is_no_slip(others, high):
    """Nor is one that returns a tenth less from there, which is what data are made to show."""
    rng = np.random.default_rng(4)
    low = 0.02 + 0.03 * (np.array(others) - 1.0) / (np.max(others) - 1.0)
    y0 = np.append(low, np.full(high, 0.2)) + 2.5e-4 * rng.normal(size=len(low) + high)
    lost = np.where(y0 > 0.1, 0.9, 1.0)
    y1 = 0.6 * lost * y0 + 2.5e-4 * rng.normal(size=y0.size)
    assert misread(table(y0, y1[:, None])) == ([], False)


def test_several_heights_ten_times_too_large_are_found():
    """They lie side by side since they are wrong."""
    rng = np.random.default_rng(3)
    made = toy(rng, n=100)
    wrong = rng.choice(np.flatnonzero(made.y0_m > 0.028), 3, replace=False)
    y0 = np.where(np.isin(np.arange(100), wrong), 10.0 * made.y0_m, made.y0_m)
    found, _ = misread(replace(made, y0_m=y0))
    assert {each.drops for each in found} == {(row + 1,) for row in wrong}


def test_many_rows_that_are_off_are_no_slips():
    """They are a shape: a band of heights, every ninth drop, drops side by side or most of the last
    ones."""
    made = toy(np.random.default_rng(8))
    spread = (np.isin(made.number, each) for each in ((43, 44, 46, 48), (9, 18, 27, 36)))
    for off in (made.y0_m > 0.045, *spread):
        values = made.values.copy()
        values[off] *= 3.0
        assert not misread(replace(made, values=values))[0]
    values[made.number == 27] /= 3.0
    found, _ = misread(replace(made, values=values))
    assert [each.drops for each in found] == [(9,), (18,), (36,)]
    rng = np.random.default_rng(9)
    heights = 0.05 + 2.5e-4 * rng.normal(size=48)
    level = table(heights, 0.03 + 2.5e-4 * rng.normal(size=(48, 1)))
    values = level.values.copy()
    values[20:24] *= 1.6
    assert not misread(replace(level, values=values))[0]
    values[21:23] = level.values[21:23]
    assert [each.drops for each in misread(replace(level, values=values))[0]] == [(21,), (24,)]


def test_what_may_have_been_meant():
    written, share, _ = meant(34.1)
    for each in (341.0, 3.41, 43.1, 34.17, 234.1):
        assert np.isclose(written, each).any(), each
    assert (share > 0.0).all()
    assert np.isclose(meant(33.1)[0], 3.1).any()


# --- errors in both heights ---------------------------------------------------------------------


def test_residuals_of_a_drop_are_whitened_for_any_slope():
    """Against draws: unit variance and no correlation, a quantity that was not read left out."""
    rng = np.random.default_rng(2)
    sigma, sigma_0 = np.array([3e-4, 2e-6, 0.5]), 4e-4
    present = np.array([[True, True, True], [True, False, True]])
    errors = Errors.independent(sigma, present, sigma_0)
    slopes = np.tile([0.6, 3e-3, 1e3], (2, 1))
    heights = sigma_0 * rng.normal(size=(200_000, 2, 1))
    left = sigma * rng.normal(size=(200_000, 2, 3)) - slopes * heights
    left[:, 1, 1] = np.nan
    rows = errors.whitened(left, slopes)[:, errors.present]
    assert rows.shape == (200_000, 5)
    assert np.cov(rows.T) == pytest.approx(np.eye(5), abs=0.02)
    as_matrix = replace(errors, whiten=errors.factors(slopes)).rows(left)
    np.testing.assert_allclose(as_matrix, rows, atol=1e-12)


@pytest.mark.parametrize("true_spread_m", [0.0, 2e-4, 5e-4])
def test_the_slope_of_heights_that_hardly_differ_is_not_taken_for_an_effect(
    true_spread_m, tmp_path, monkeypatch
):
    """Sixty drops from 50 mm: what is read of the height after falls with the error of the one
    before, as it would if contact yielded. What is tested is looked at against heights that both
    readings make together, of which the rest is independent; or against one height, where these
    differ by no more than they err."""
    names = [*QUICK, "plastic_contact"]
    monkeypatch.setattr(drops_module, "carried", lambda kind, quantities: names)
    rng = np.random.default_rng(3)
    height = 0.05 + true_spread_m * rng.normal(size=60)
    seen = np.column_stack([height, 0.6575 * height]) + 4e-4 * rng.normal(size=(60, 2))
    write_table(tmp_path, seen, sigma_mm=0.4)
    problem = drops_problem(read_drops(tmp_path))
    assert problem.baseline.errors.values is not None
    left = problem.values - problem.baseline.predict(np.array([2e6]))[0]
    fitted = problem.covariates["height"]
    error = 1.0 / math.sqrt(58)
    # by theory the correlation with what was read is -0.55 where heights are all the same
    as_read = np.corrcoef(left, seen[:, 0])[0, 1]
    if true_spread_m == 0.0:
        assert as_read == pytest.approx(-0.6575 / math.hypot(1.0, 0.6575), abs=3.0 * error)
    assert (np.ptp(fitted) > 0.0) == (true_spread_m > 4e-4)
    if np.ptp(fitted) > 0.0:
        assert np.corrcoef(left, fitted)[0, 1] == pytest.approx(0.0, abs=3.0 * error)
    assert find(problem).verdict == "adequate"


def test_the_error_of_the_height_before_may_be_declared_apart(tmp_path):
    write_drops(tmp_path)
    one = drops_problem(read_drops(tmp_path))
    text = (tmp_path / "dataset.toml").read_text()
    (tmp_path / "dataset.toml").write_text(f"{text}sigma_y0_mm = 1.2\n")
    other = drops_problem(read_drops(tmp_path))
    slope = float(np.median(read_drops(tmp_path).y1_m / read_drops(tmp_path).y0_m))
    expected = math.hypot(1.0, 4.0 * slope) / math.hypot(1.0, slope)
    assert np.median(other.scale) / np.median(one.scale) == pytest.approx(expected, rel=0.02)


# --- cells --------------------------------------------------------------------------------------


def write_table(folder: Path, seen, sigma_mm=SIGMA_MM, numbers=None, extra=None):
    """Heights in m (drops, 2) as a dataset; ``extra`` is a column and its cells."""
    numbers = 1 + np.arange(len(seen)) if numbers is None else numbers
    head, cells = extra or ("", [""] * len(seen))
    rows = [
        f"{n},{1e3 * y0:.4f},{1e3 * y1:.4f}{',' if head else ''}{cell}"
        for n, (y0, y1), cell in zip(numbers, seen, cells, strict=True)
    ]
    title = "drop,y0_mm,y1_mm" + (f",{head}" if head else "")
    (folder / "drops.csv").write_text("\n".join([title, *rows, ""]))
    (folder / "dataset.toml").write_text(HEAD.replace("0.3", f"{sigma_mm}"))
    return folder


def edited(folder: Path, change):
    """The dataset with the cells of its rows changed."""
    head, *rows = [line.split(",") for line in (folder / "drops.csv").read_text().split()]
    change(rows)
    (folder / "drops.csv").write_text("\n".join(",".join(row) for row in (head, *rows)) + "\n")
    return folder


@pytest.mark.parametrize(("softer", "slips"), [(1, [(7,)]), (7, [])])
def test_drops_of_which_all_numbers_are_off_are_no_slips_if_they_are_many(tmp_path, softer, slips):
    """Contact that is softer by 2.5 in some drops moves height, contact time and force."""
    write_drops(tmp_path, forces=True)

    def soften(rows):
        for i in (6, 9, 17, 20, 26, 33, 35)[:softer]:
            moved = zip((1.28, 1.33, 0.85), rows[i][2:5], strict=True)
            rows[i][2:5] = [f"{by * float(x):.6g}" for by, x in moved]

    problem = drops_problem(read_drops(edited(tmp_path, soften)))
    assert [each.drops for each in problem.bookkeeping] == slips
    assert all("other numbers" in each.why for each in problem.bookkeeping)


@pytest.mark.parametrize("off_mm", [7.0, 8.0, 9.0])
@pytest.mark.parametrize("first", [10, 20, 30])
def test_a_slip_beside_drops_that_are_off_together_stays_a_slip(tmp_path, off_mm, first):
    """A band of heights is physics; it says nothing of a point that is displaced."""
    write_drops(tmp_path)

    def change(rows):
        rows.sort(key=lambda row: float(row[1]))
        for row in rows[first : first + 3]:
            row[2] = f"{float(row[2]) + off_mm:.4f}"
        rows[4][2] = f"{10.0 * float(rows[4][2]):.4f}"
        slip.append(int(rows[4][0]))

    slip: list[int] = []
    problem = drops_problem(read_drops(edited(tmp_path, change)))
    assert tuple(slip) in [each.drops for each in problem.bookkeeping]


def test_an_empty_cell_costs_itself(tmp_path):
    """Of the quantities that a drop has, each that was read is a row of its own."""
    write_drops(tmp_path, forces=True)
    whole = drops_problem(read_drops(tmp_path))

    def empty(rows):
        rows[0][2] = ""  # the first height after
        for row in rows[6:]:
            row[3] = ""  # contact times in six drops alone
        rows[9][1] = ""  # of a drop no height before

    problem = drops_problem(read_drops(edited(tmp_path, empty)))
    names = list(problem.quantity)
    assert [names.count(name) for name in dict.fromkeys(whole.quantity)] == [38, 6, 39]
    assert problem.main == "y1 (mm)"
    assert problem.left_aside == ("drops without y0_mm: 10",)
    assert 10 not in problem.group
    theta = np.array([2e6, 1.0])
    for model, of in ((whole, whole.group), (problem, problem.group)):
        assert model.baseline.predict(theta).shape[-1] == of.size
    # whitening ties a drop's quantities together, and the heights after come first
    first = (problem.quantity == "y1 (mm)") & (problem.group > 6)
    same = (whole.quantity == "y1 (mm)") & np.isin(whole.group, problem.group[first])
    assert problem.values[first] == pytest.approx(whole.values[same], rel=2e-3)


def test_commas_alone_are_an_empty_line(tmp_path):
    """As spreadsheets leave them below a table, where cells were once filled."""
    write_drops(tmp_path)
    whole = read_drops(tmp_path)
    again = read_drops(edited(tmp_path, lambda rows: rows.extend(2 * [["", "", ""]])))
    assert np.array_equal(again.y1_m, whole.y1_m)
    with pytest.raises(InputError, match=r"drops.csv:44: drop is no number"):
        read_drops(edited(tmp_path, lambda rows: rows.append(["", "20", ""])))


def test_a_column_without_a_value_is_as_none(tmp_path):
    write_drops(tmp_path, forces=True)
    found = read_drops(edited(tmp_path, lambda rows: [row.__setitem__(3, "") for row in rows]))
    assert found.contact_time_s is None
    assert set(drops_problem(found).quantity) == {"y1 (mm)", "peak force (N)"}


def test_errors_that_nobody_declares_are_said_to_be_taken_from_the_data(tmp_path):
    (tmp_path / "dataset.toml").write_text(HEAD.replace("sigma_y_mm", "file = 'drops.csv' #"))
    (tmp_path / "drops.csv").write_text("drop,y0_mm,y1_mm\n1,10,6.4\n2,20,13\n3,30,19\n4,40,26\n")
    (said,) = read_problem(tmp_path).warnings
    assert said.startswith("sigma_y_mm is not declared")


def test_a_reading_may_lie_some_sigma_below_zero(tmp_path):
    write_drops(tmp_path)
    edited(tmp_path, lambda rows: rows[3].__setitem__(2, "-1.4"))
    assert read_drops(tmp_path).y1_m[3] == -1.4e-3
    edited(tmp_path, lambda rows: rows[3].__setitem__(2, "-1.6"))
    with pytest.raises(InputError, match=r"drops.csv:5: y1_mm must be -1.5 or more"):
        read_drops(tmp_path)


def test_a_small_peak_may_be_read_some_sigma_too_small(tmp_path):
    """A hundredth of a newton is no peak of this bristle, but may be what a coarse gauge says."""
    write_drops(tmp_path, forces=True)

    def small(rows):
        rows[0][4] = "0.01"

    def below(rows):
        rows[0][4] = "-0.2"

    assert read_drops(edited(tmp_path, small)).peak_force_N[0] == pytest.approx(0.01)
    fine = declared(tmp_path, sigma_force_N=1e-3)
    with pytest.raises(InputError, match=r"a peak of 0\.01 N is not one of this body"):
        read_drops(fine)
    with pytest.raises(InputError, match="peak_force_N must be"):
        read_drops(edited(fine, below))
    write_drops(tmp_path, forces=True)
    assert read_drops(edited(tmp_path, below)).peak_force_N[0] == pytest.approx(-0.2)


def test_rows_may_stand_in_any_order(tmp_path):
    """Their numbers say in which they were made."""
    write_drops(tmp_path, forces=True)
    whole = drops_problem(read_drops(tmp_path))
    edited(tmp_path, lambda rows: rows.sort(key=lambda row: row[1]))
    shuffled = drops_problem(read_drops(tmp_path))
    assert np.array_equal(shuffled.values, whole.values)
    assert np.array_equal(shuffled.group, whole.group)


# --- sessions and error bars --------------------------------------------------------------------


def test_numbers_that_are_missing_begin_a_session_and_are_no_drops():
    numbers = np.array([1.0, 2.0, 4.0, 5.0, 1001.0, 1002.0])
    assert list(order_of(numbers)) == [0.0, 1.0, 3.0, 4.0, 5.0, 6.0]
    assert list(order_of(np.arange(5.0, 105.0, 5.0))) == list(np.arange(0.0, 100.0, 5.0))


@pytest.fixture
def few(monkeypatch):
    """A handful of candidates, which need no tables of their own."""
    names = [*QUICK, "session"]
    monkeypatch.setattr(drops_module, "carried", lambda kind, quantities: list(names))


def two_days(tmp_path, **how):
    """Drops whose contact is a fifth stiffer in the second half, by the program's own beam."""
    one, other = tmp_path / "one", tmp_path / "other"
    write_drops(one)
    write_drops(other, [EFFECTS["session"](0.12)])
    first, second = (
        np.column_stack([each.y0_m, each.y1_m]) for each in map(read_drops, (one, other))
    )
    return write_table(tmp_path, np.concatenate([first[:20], second[20:]]), **how)


@pytest.mark.parametrize("told", ["column", "gap", "nowhere"])
def test_a_difference_between_sessions_is_named_as_such(told, few, tmp_path):
    how = {
        "column": {"extra": ("session", ["a"] * 20 + ["b"] * 20)},
        "gap": {"numbers": [*range(1, 21), *range(1001, 1021)]},
        "nowhere": {},
    }[told]
    found = find(drops_problem(read_drops(two_days(tmp_path, **how))))
    assert found.effects == ("session",)
    where = {"column": "of b", "gap": "from drop 1001 on", "nowhere": "from drop"}[told]
    assert f"a difference between sessions {where}" in opening(found)[0]
    assert found.parameters["decades"].low < 0.12 < found.parameters["decades"].high


def test_a_session_begins_where_it_does_whichever_drops_are_held_out(few, tmp_path):
    """The last drops of the first session tell its end, though the model is not fitted to them."""
    problem = drops_problem(read_drops(two_days(tmp_path)))
    held = (3, 9, 12, 15, 20, 21, 27, 30, 34, 38)
    found = find(replace(problem, held=held))
    assert found.effects == ("session",)
    alone = find(replace(problem, held=tuple(range(2, 40, 4))))
    assert found.remarks == alone.remarks


def test_drops_without_a_session_are_one_of_their_own_and_told(few, tmp_path):
    """A cell may be empty."""
    names = ["a"] * 20 + [""] * 2 + ["b"] * 18
    problem = drops_problem(read_drops(two_days(tmp_path, extra=("session", names))))
    (doubt,) = [each for each in problem.warnings if "3 sessions" in each]
    assert "the drops without a name among them" in doubt
    found = find(problem)
    assert found.effects == ("session",)
    assert found.remarks["session",]["session"] in ("of no name, b", "of b")
    unnamed = drops_problem(read_drops(two_days(tmp_path, extra=("session", [""] * 40))))
    assert not any("sessions" in each for each in unnamed.warnings)


def test_a_session_that_the_table_tells_may_have_two_drops():
    drop = 1.0 + np.arange(12)
    told = Partings(drop, np.repeat([0, 1], [2, 10]), ("a", "b"))
    assert list(told.possible) == [0]
    assert list(np.flatnonzero(told.parted(np.zeros(1)).second == 0.0)) == [0, 1]
    untold = Partings(drop, np.zeros(12, dtype=int))
    first = untold.parted(-np.arange(float(untold.possible.size)))
    assert np.sum(first.second == 0.0) == 4


def test_a_row_that_stands_twice_is_told_and_counted_once(few, tmp_path):
    write_drops(tmp_path)
    whole = drops_problem(read_drops(tmp_path))
    problem = read_problem(edited(tmp_path, lambda rows: rows.append(rows[6])))
    assert np.array_equal(problem.values, whole.values)
    (entry,) = problem.bookkeeping
    assert (entry.kind, entry.drops) == ("repeated", (7,))


def test_wear_is_no_session(few, tmp_path):
    write_drops(tmp_path, [EFFECTS["wear"](1.5)])
    assert find(drops_problem(read_drops(tmp_path))).effects == ("wear",)


def test_error_bars_that_are_too_large_are_said_to_be_and_hide_nothing(few, tmp_path):
    write_drops(tmp_path, [EFFECTS["wear"](1.0)])
    text = (tmp_path / "dataset.toml").read_text()
    (tmp_path / "dataset.toml").write_text(text.replace(f"= {SIGMA_MM}", f"= {5 * SIGMA_MM}"))
    problem = drops_problem(read_drops(tmp_path))
    (told,) = Scatter.each(problem)
    assert 5.0 / (1.0 + 3.0 * told.error) < 1.0 / told.ratio < 5.0 * (1.0 + 3.0 * told.error)
    found = find(problem)
    assert found.effects == ("wear",)
    assert found.warnings[0].startswith("your error bars are")
    # y1 rises by 0.65 of y0, whose error is the same
    made = math.hypot(1.0, 0.65) * 5 * SIGMA_MM
    (declared,) = re.findall(
        r"with that of the height before, would make (\S+)\. ", found.warnings[0]
    )
    assert float(declared) == pytest.approx(made, rel=0.1)
    assert "times too large" in found.warnings[0]


def test_tails_are_part_of_an_error_bar(few, tmp_path):
    """One reading in twenty errs fifteen times as much as the others. Those scatter by a third of
    the standard deviation, which is what was declared."""
    rng = np.random.default_rng(3)
    height = rng.uniform(0.01, 0.05, 120)
    errors = 1e-4 * rng.normal(size=120) * np.where(np.arange(120) % 20 == 4, 15.0, 1.0)
    seen = np.column_stack([height, 0.6575 * height + errors])
    sigma_mm = 1e3 * float(np.std(errors)) / math.hypot(1.0, 0.6575)  # that of y0 has a share
    write_table(tmp_path, seen, sigma_mm=sigma_mm)
    (told,) = Scatter.each(drops_problem(read_drops(tmp_path)))
    assert told.ratio < 0.5 < told.whole
    assert not told.far_smaller


def test_error_bars_that_are_too_small_are_said_to_be_and_are_no_effect(few, tmp_path):
    rng = np.random.default_rng(9)
    height = rng.uniform(0.045, 0.05, 48)
    seen = np.column_stack([height, 0.6575 * height]) + 3e-4 * rng.normal(size=(48, 2))
    write_table(tmp_path, seen, sigma_mm=0.1)
    found = find(drops_problem(read_drops(tmp_path)))
    assert found.verdict == "adequate"
    assert "times too small" in found.warnings[0]


def declared(folder: Path, **times: float) -> Path:
    """The dataset with errors that are declared so many times as large."""
    path = folder / "dataset.toml"
    for key, size in (("sigma_y_mm", SIGMA_MM), ("sigma_t_s", SIGMA_S), ("sigma_force_N", SIGMA_N)):
        text = path.read_text()
        path.write_text(text.replace(f"{key} = {size}", f"{key} = {times.get(key, 1.0) * size}"))
    return folder


def test_error_bars_that_are_too_small_hide_no_effect(few, tmp_path):
    """Nor do drops that differ by chance come in their place."""
    write_drops(tmp_path, [EFFECTS["wear"](1.0)])
    found = find(drops_problem(read_drops(declared(tmp_path, sigma_y_mm=1.0 / 3.0))))
    assert found.effects == ("wear",)
    assert "times too small" in found.warnings[0]


@pytest.mark.parametrize("off", [1.0 / 3.0, 5.0])
def test_error_bars_of_each_quantity_are_held_against_its_scatter(off, few, tmp_path):
    write_drops(tmp_path, forces=True)
    problem = drops_problem(read_drops(declared(tmp_path, sigma_t_s=off, sigma_force_N=off)))
    found = find(problem)
    assert found.verdict == "adequate"
    said = [each for each in found.warnings if "error bars" in each]
    assert ["contact time" in said[0], "peak force" in said[1]] == [True, True]
    for told in Scatter.each(problem)[1:]:
        assert told.ratio * off == pytest.approx(1.0, abs=3.0 * told.error)


def test_a_drift_is_no_noise(few, tmp_path):
    """A slow wave in the order, four sigma high: neighbours are alike, and noise's are not."""
    rng = np.random.default_rng(1)
    height = rng.uniform(0.01, 0.05, 48)
    wave = 4e-3 * SIGMA_MM * np.sin(2.0 * np.pi * np.arange(48) / 11.0)
    seen = np.column_stack([height, 0.6575 * height]) + 1e-3 * SIGMA_MM * rng.normal(size=(48, 2))
    problem = drops_problem(read_drops(write_table(tmp_path, seen + [0.0, 1.0] * wave[:, None])))
    (told,) = Scatter.each(problem)
    assert not told.larger
    found = find(problem)
    assert found.verdict == "unknown"
    assert not any("error bars" in each for each in found.warnings)


@pytest.mark.parametrize(("truth", "number"), [("waves", 15), ("subset", 37), ("subset", 10)])
def test_what_has_a_form_is_no_noise(truth, number, few, tmp_path):
    """Several waves in one of three quantities, and a part of the drops that is off in one of two,
    once with slips besides: shapes by other code, which wider errors explained before."""
    made = make(96239942, "unlisted16", number)
    assert made.record()["truth"] == truth
    made.write(tmp_path)
    found = find(drops_problem(read_drops(tmp_path)), number)
    assert found.verdict == "unknown"
    assert not any("error bars" in each for each in found.warnings)


@pytest.mark.parametrize(
    ("true_mm", "mark_mm", "are_read"),
    [((10.0, 20.0, 30.0), 1e-3, False), ((30.0, 31.0), 0.1, True), ((30.0, 30.5), 1e-3, True)],
)
def test_a_ruler_does_not_make_heights_that_were_set(true_mm, mark_mm, are_read):
    """Readings of a height that was set are alike to the last digit; those by a ruler lie on its
    marks, and still err."""
    rng = np.random.default_rng(2)
    height = np.resize(true_mm, 200) + (0.25 * rng.normal(size=200) if are_read else 0.0)
    read = 1e-3 * mark_mm * np.round(height / mark_mm)
    assert drops_module._close_together(read, 2.5e-4) == are_read


def test_an_outlier_that_is_held_out_refuses_no_effect(few, tmp_path, monkeypatch):
    """A fit that saw none does not know that there is none. Were it sure of it, this one would cost
    more than wear gains on all others, since the wider noise of a fit without wear allows it."""
    monkeypatch.setattr(
        drops_module, "misread", lambda table, before: ([], before)
    )  # as if noise made them
    write_drops(tmp_path, [EFFECTS["wear"](1.5)])
    held = split(drops_problem(read_drops(tmp_path)), 0)[1][5]

    def raised(rows):
        row = rows[held - 1]
        row[2] = f"{float(row[2]) + 20.0 * SIGMA_MM:.4f}"

    found = find(drops_problem(read_drops(edited(tmp_path, raised))))
    assert found.effects == ("wear",)
    assert found.held_out.greatest > 10.0
    assert found.held_out.gain.low > 0.0


def test_a_slip_is_set_aside_and_the_effect_is_found(few, tmp_path):
    """It is sought where it makes a height like the others: a tenth of a rebound and ten times a
    height leave the same ratio."""
    write_drops(tmp_path, [EFFECTS["wear"](1.5)])
    edited(tmp_path, lambda rows: rows[17].__setitem__(2, f"{0.1 * float(rows[17][2]):.4f}"))
    found = find(drops_problem(read_drops(tmp_path)))
    assert found.effects == ("wear",)
    (entry,) = found.verdict_json()["bookkeeping"]
    assert (entry["kind"], entry["drops"]) == ("slip", [18])
    assert entry["why"].startswith("y1_mm")


@pytest.mark.parametrize("scatter_mm", [0.0, 0.3])
def test_one_height_to_the_last_digit_is_a_table_like_others(scatter_mm, few, tmp_path):
    rng = np.random.default_rng(4)
    seen = np.column_stack([np.full(20, 0.03), 0.0195 + 1e-3 * scatter_mm * rng.normal(size=20)])
    write_table(tmp_path, seen)
    assert find(drops_problem(read_drops(tmp_path))).verdict == "adequate"
