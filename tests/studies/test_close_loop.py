"""`bristle close-loop` ends with the verdict, the page and the exit status that it promises.

Measured datasets lie in ``shared/data`` beside the repository; where they are not, their tests are
skipped. Each ``dataset.toml`` there names its public source and commit.
"""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from pathlib import Path

import commands
import numpy as np
import pytest
from blind.drops import PLASTIC, Truth, seen
from hostile import refused
from made_drops import COUNT, QUICK, SIGMA_MM, SIGMA_N, SIGMA_S, write_drops

from bristle.solver.effects.library import EFFECTS
from bristle.solver.errors import ComputationError
from bristle.studies.cli import main
from bristle.studies.close_loop import run as close_loop_study
from bristle.studies.close_loop.confirm import Confirmation, Solid
from bristle.studies.close_loop.directions import directions
from bristle.studies.data import datasets
from bristle.studies.loop.finding import Verdict
from bristle.studies.loop.kinds.drops import problem as drops_module
from bristle.studies.loop.kinds.drops.problem import drops_problem
from bristle.studies.loop.kinds.drops.solid import chances, solid_drops
from bristle.studies.loop.run import find
from bristle.studies.running.files import write_atomically
from bristle.studies.running.mark import MARK

pytestmark = [pytest.mark.serial, pytest.mark.usefixtures("no_pictures")]

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
MEASURED = Path(__file__).resolve().parents[2] / "studies" / "measured"
KEYS = {
    "verdict", "effects", "weights", "probabilities", "bookkeeping", "fit", "noise",
    "detection", "open_set", "parameters", "classes", "detectable",
    "held_out", "confirmed_in_3d", "next_experiment", "seed", "in_words", "warnings",
}  # fmt: skip
SECTIONS = (
    "noise", "baseline", "residuals", "tests", "detectable", "evidence", "attribution", "left",
    "held-out", "solid", "next",
)  # fmt: skip
# As in the README's example.
README_BETA_S = 9.445e-9
NASTY = "<script>alert(1)</script> & drops"


def read_strictly(path: Path) -> dict:
    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def closed(dataset, out, *options) -> dict:
    """The verdict on a dataset whose loop is closed into a folder."""
    assert main(["close-loop", str(dataset), "--out", str(out), *options]) == 0
    return read_strictly(out / "verdict.json")


@pytest.fixture(scope="module")
def quick():
    """The library without effects that have to be simulated first."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drops_module, "carried", lambda kind, quantities: list(QUICK))
        yield


@pytest.fixture(scope="module")
def worn(tmp_path_factory, quick) -> tuple[Path, Path]:
    """A dataset in which the contact wears, and the folder of its closed loop."""
    folder = tmp_path_factory.mktemp("worn")
    dataset = write_drops(folder / "data", [EFFECTS["wear"](decades=2.0)], NASTY)
    out = folder / "deep" / "out"
    closed(dataset, out, "--seed", "3", "--no-3d")
    return dataset, out


def test_the_verdict_has_the_keys_of_the_contract_and_names_what_is_missing(worn):
    content = read_strictly(worn[1] / "verdict.json")
    assert set(content) >= KEYS
    assert content["verdict"] == "effect"
    assert content["effects"] == ["wear"]
    assert content["weights"]["wear"] == pytest.approx(1.0, abs=0.05)
    assert content["probabilities"]["wear"] > 0.9
    assert content["seed"] == 3
    assert content["detection"]["p_value"] < 0.03 < content["open_set"]["p_value"]
    wear = content["parameters"]["decades"]
    # 90 % intervals: the truth lies within twice their width all but always
    assert abs(wear["estimate"] - 2.0) < wear["high"] - wear["low"]
    held = content["held_out"]
    assert held["rms_after"] < 0.5 * held["rms_before"]
    assert held["unit"] == "mm"
    assert set(held["groups"]) <= set(range(1, COUNT + 1))
    assert content["confirmed_in_3d"] is None
    assert "--no-3d" in content["confirmed_in_3d_why"]
    command = f"bristle close-loop {worn[0]} --seed 3 --no-3d --out {worn[1]}"
    assert command in (worn[1] / "report.html").read_text()


def test_a_p_value_that_is_hardly_a_number_is_told_as_less_than_one(worn):
    content = read_strictly(worn[1] / "verdict.json")
    for p_value in (3e-310, 0.0):
        told = dict(close_loop_study.summary(content | {"detection": {"p_value": p_value}}))
        assert told["something is missing"] == (
            "p < 1e-300: chance makes data as odd as these less than once in a billion times"
        )


def test_a_difference_between_sessions_is_seen_and_no_effect_is_named_for_it(tmp_path, quick):
    """Of two that alternate at random, the second reads lower by some errors of measurement."""
    folder = write_drops(tmp_path / "data")
    head, *rows = (folder / "drops.csv").read_text().split()
    second = np.random.default_rng(5).random(len(rows)) < 0.5
    for i, row in enumerate(rows):
        drop, y0, y1 = row.split(",")
        lower = 5.0 * SIGMA_MM if second[i] else 0.0
        rows[i] = f"{drop},{y0},{float(y1) - lower:.4f},{'b' if second[i] else 'a'}"
    (folder / "drops.csv").write_text("\n".join([f"{head},session", *rows, ""]))
    content = closed(folder, tmp_path / "out", "--no-3d")
    assert content["verdict"] == "unknown"
    assert "session" in content["detection"]["statistic"]


def test_the_page_has_every_step_with_its_table_and_escapes_the_title(worn):
    page = (worn[1] / "report.html").read_text()
    for section in SECTIONS:
        assert f'<section id="{section}"' in page
    assert NASTY not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; drops" in page
    names = {path.stem for path in (worn[1] / "tables").iterdir()}
    assert names >= {"fit", "residuals", "tests", "detectable", "evidence", "held_out", "errors"}
    rows = (worn[1] / "tables" / "residuals.csv").read_text().splitlines()
    assert len(rows) == COUNT + 1
    assert rows[0] == "group,quantity,height,order,before,after,held_out"
    assert {path.name for path in worn[1].iterdir()} == {
        "verdict.json", "report.html", "tables", "figures", MARK,
    }  # fmt: skip


def test_the_page_has_the_errors_that_the_data_were_fitted_with(tmp_path, quick):
    """Five times as large are declared: values are as measured, and residuals are of unit size."""
    folder = write_drops(tmp_path / "data", [EFFECTS["wear"](decades=1.0)])
    manifest = folder / "dataset.toml"
    manifest.write_text(manifest.read_text().replace(f"= {SIGMA_MM}", f"= {5 * SIGMA_MM}"))
    content = closed(folder, tmp_path / "out", "--no-3d")
    assert content["effects"] == ["wear"]
    assert "times too large" in content["warnings"][0]
    fit, left = (
        np.genfromtxt(tmp_path / "out" / "tables" / f"{name}.csv", delimiter=",", names=True)
        for name in ("fit", "residuals")
    )
    drops = np.genfromtxt(folder / "drops.csv", delimiter=",", names=True)
    assert fit["measured"] == pytest.approx(drops["y1_mm"], abs=1e-3)
    assert np.sqrt(np.mean((fit["measured"] - fit["after"]) ** 2)) < 2.0 * SIGMA_MM
    assert np.sqrt(np.mean(left["after"] ** 2)) == pytest.approx(1.0, abs=0.4)


def test_a_column_whose_errors_nobody_declares_is_doubted_whichever_errors_are_used(tmp_path):
    folder = write_drops(tmp_path / "data", forces=True)
    manifest = folder / "dataset.toml"
    manifest.write_text(manifest.read_text().replace("sigma_t_s", "# sigma_t_s"))
    problem = close_loop_study.problem_of(datasets.read_manifest(folder))
    for each in (problem, problem.with_sigma({"y1 (mm)": 2.0})):
        (doubt,) = each.warnings
        assert doubt.startswith(
            "contact time (µs) is left aside: the dataset declares no sigma_t_s"
        )
        assert "declare it" in doubt


def test_a_finding_can_be_sent_to_another_rank_with_its_problem(tmp_path, quick):
    found = find(drops_problem(datasets.read_drops(write_drops(tmp_path / "data"))))
    again = pickle.loads(pickle.dumps(close_loop_study.sendable(found)))
    assert json.dumps(again.verdict_json()) == json.dumps(found.verdict_json())
    assert np.array_equal(again.problem.values, found.problem.values)


def test_the_same_seed_gives_the_same_bytes_also_from_its_own_output(worn, tmp_path):
    dataset, out = worn
    first = (out / "verdict.json").read_bytes()
    closed(dataset, tmp_path / "again", "--config", str(out / "verdict.json"))
    assert (tmp_path / "again" / "verdict.json").read_bytes() == first
    assert str(dataset).encode() not in first


def test_data_that_lack_nothing_are_adequate_and_confirmed_by_the_solid(quick, tmp_path, capsys):
    dataset = write_drops(tmp_path / "data")
    content = closed(dataset, tmp_path / "out")
    assert content["verdict"] == "adequate"
    assert content["effects"] == []
    kn = content["parameters"]["kn_N_m"]
    assert abs(kn["estimate"] - 2e6) < kn["high"] - kn["low"]
    solid, held = content["confirmed_in_3d"], content["held_out"]
    assert solid["rms_before"] == pytest.approx(held["rms_before"], rel=0.1)
    assert solid["rms_after"] == solid["rms_before"]
    assert solid["rms_after"] < 2.0 * SIGMA_MM
    assert not any("3-D model" in each for each in content["warnings"])
    said = capsys.readouterr()
    assert "adequate" in said.out
    noise = content["held_out"]["noise"]
    (error,) = [line for line in said.out.splitlines() if line.startswith("held-out error")]
    assert error.split(maxsplit=2)[2] == f"{held['rms_after']:.3g} mm; noise {noise:.3g}"
    assert "report.html" in said.out


def test_a_solid_that_predicts_far_worse_is_doubted(quick, tmp_path, monkeypatch):
    dataset = write_drops(tmp_path / "data")
    far = np.full(3, 20.0 * SIGMA_MM)
    solid = Solid("mm", np.arange(3), np.zeros(3), far, far)
    monkeypatch.setattr(close_loop_study, "confirm", lambda finding: Confirmation(solid))
    content = closed(dataset, tmp_path / "out")
    assert content["verdict"] == "adequate"
    held = content["held_out"]
    times = 20.0 * SIGMA_MM / max(held["rms_after"], held["noise"])
    (doubt,) = [each for each in content["warnings"] if each.startswith("the 3-D model")]
    assert f" {times:.2g} times worse than the model that was fitted" in doubt
    assert doubt in (tmp_path / "out" / "report.html").read_text()


def test_the_solid_follows_the_beam_with_effects_in_it(quick, tmp_path):
    problem = drops_problem(datasets.read_drops(write_drops(tmp_path / "data")))
    effects = ("release_velocity", "scale_error", "height_offset", "wear")
    model = problem.combine(effects)
    theta = np.array([2e6, 0.2, 0.05, 1e-3, 1.0])
    which = [0, 7, 19, 39]
    beam = model.measured(theta)[0, which]
    assert solid_drops(model, theta, which) == pytest.approx(beam, rel=2e-3)
    plain = solid_drops(problem.baseline, theta[:1], which)
    assert np.all(np.abs(plain / beam - 1.0) > 0.01)


PAIR = ("plastic_contact", "material_damping")
PAIR_AT = np.array([2e6, 20.0, 3e-5])


def test_two_effects_are_as_the_solid_has_them_once_they_are_simulated(tmp_path):
    """Tables know them one by one, and are off by a tenth; the solid is simulated by itself."""
    problem = drops_problem(datasets.read_drops(write_drops(tmp_path / "data")))
    model, which = problem.combine(PAIR), list(range(0, COUNT, 4))
    solid = solid_drops(model, PAIR_AT, which)
    tabulated = model.measured(PAIR_AT)[0, which]
    assert np.abs(tabulated / solid - 1.0).max() > 0.05
    simulated = model.simulated(PAIR_AT)
    assert simulated.measured(PAIR_AT)[0, which] == pytest.approx(solid, rel=3e-3)
    assert simulated.effects == PAIR
    for names in ((), ("wear",), ("surface_slope",)):
        plain = problem.combine(names)
        theta = np.array([2e6, *(each.typical for each in plain.parameters[1:])])
        assert plain.simulated(theta) is plain


def test_simulations_make_slopes_right_too(tmp_path):
    """A fit that only shifts tables at its place drifts along what their slopes have wrong."""
    problem = drops_problem(datasets.read_drops(write_drops(tmp_path / "data")))
    model, here = problem.combine(PAIR), PAIR_AT * [1.0, 1.0, 1.3]
    there = model.simulated(PAIR_AT).measured(PAIR_AT)
    shifted = model.simulated(here)
    learnt = shifted.simulated(PAIR_AT).simulated(here)
    miss = [np.abs(each.measured(PAIR_AT) / there - 1.0).max() for each in (shifted, learnt)]
    assert miss[0] > 3e-3
    assert miss[1] < 1e-9


def test_the_error_of_the_height_before_is_carried_by_the_slope_that_the_data_have(tmp_path):
    """Above yield a plastic contact gives back about the same height, whatever that before."""
    effects = [EFFECTS["plastic_contact"](20.0), EFFECTS["material_damping"](3e-5)]
    data = write_drops(tmp_path / "data", effects, forces=True)
    problem = drops_problem(datasets.read_drops(data))
    model, drops = problem.combine(PAIR), problem.baseline.drops
    truth = np.array([PAIR_AT[0], 1.0, *PAIR_AT[1:]])
    low, high = (
        replace(model, drops=replace(drops, y0_m=by * drops.y0_m)).simulated(truth).measured(truth)
        for by in (0.98, 1.02)
    )
    slope = ((high - low)[0].T / (0.04 * drops.y0_m)).T
    sigma = np.array([1e-3 * SIGMA_MM, SIGMA_S, SIGMA_N])
    square = sigma**2 + (sigma[0] * slope) ** 2
    mixing = np.linalg.inv(problem.baseline.errors.whiten)
    taken = np.einsum("dqr,dqr->dq", mixing, mixing)
    # five hundredths where slopes are the baseline's by one factor
    assert np.abs(np.log(taken / square)).mean(axis=0) == pytest.approx(0.0, abs=0.012)


@pytest.mark.parametrize(
    "truth",
    [
        {"material_damping": ("beta_s", 2e-6), "stiffening_contact": ("exponent", 2.0)},
        pytest.param(
            {"material_damping": ("beta_s", 3e-5), "plastic_contact": ("yield_N", 20.0)},
            marks=pytest.mark.campaign,
        ),
    ],
    ids=" and ".join,
)
def test_two_strong_effects_are_both_named(truth, tmp_path, monkeypatch):
    """From tables alone the exponent would be 1.45 (1.40 to 1.52), and nothing named."""
    names = [*QUICK, *truth, "contact_damping"]
    monkeypatch.setattr(drops_module, "carried", lambda kind, quantities: names)
    strong = [EFFECTS[name](**{own: value}) for name, (own, value) in truth.items()]
    dataset = write_drops(tmp_path / "data", strong, forces=True)
    content = closed(dataset, tmp_path / "out", "--no-3d")
    assert content["verdict"] == "effect"
    assert sorted(content["effects"]) == sorted(truth)
    for own, value in truth.values():
        told = content["parameters"][own]
        assert abs(told["estimate"] - value) < told["high"] - told["low"]


@pytest.mark.campaign
def test_a_contact_that_yields_by_another_law_is_found_and_confirmed(tmp_path, monkeypatch):
    """By other physics, and a law that hardens and unloads three times as stiffly."""
    names = [*QUICK, "plastic_contact"]
    monkeypatch.setattr(drops_module, "carried", lambda kind, quantities: names)
    folder, rng = write_drops(tmp_path / "data"), np.random.default_rng(4)
    heights = rng.permutation(np.resize([0.01, 0.02, 0.03, 0.05, 0.07, 0.09], COUNT))
    truth = Truth(kn_N_m=2e6, law=PLASTIC, number=25.0, hardens=0.1, unloads=3.0)
    read = 1e3 * seen(truth, heights, np.zeros((COUNT, 2)))[:, :2]
    read += SIGMA_MM * rng.standard_normal(read.shape)
    rows = [f"{i + 1},{y0:.4f},{y1:.4f}\n" for i, (y0, y1) in enumerate(read)]
    (folder / "drops.csv").write_text("".join(["drop,y0_mm,y1_mm\n", *rows]))
    content = closed(folder, tmp_path / "out")
    assert content["verdict"] == "effect"
    assert content["effects"] == ["plastic_contact"]
    for name, true in {"yield_N": 25.0, "hardening": 0.1, "unloading": 3.0}.items():
        told = content["parameters"][name]
        assert abs(told["estimate"] - true) < told["high"] - told["low"]
    held, solid = content["held_out"], content["confirmed_in_3d"]
    assert held["rms_after"] < 2.0 * SIGMA_MM < 0.1 * held["rms_before"]
    assert solid["rms_after"] == pytest.approx(held["rms_after"], rel=0.2)


def test_noise_that_is_wider_than_declared_is_no_scatter_of_the_surface(quick, tmp_path):
    """Random stiffness would scatter y1 in proportion to the height; noise does not. Nothing is
    missing then but better error bars."""
    folder = write_drops(tmp_path / "data")
    manifest = folder / "dataset.toml"
    declared = manifest.read_text()
    manifest.write_text(declared.replace(f"sigma_y_mm = {SIGMA_MM}", "sigma_y_mm = 0.03"))
    problem = drops_problem(datasets.read_drops(folder))
    found = find(problem, seed=0)
    assert found.verdict is Verdict.ADEQUATE
    assert "times too small" in found.warnings[0]
    found = find(replace(problem, with_sigma=None), seed=0)
    assert found.verdict is Verdict.UNKNOWN
    assert found.shape.endswith("times as wide as is declared")
    refused = {each.effects: each.why_not for each in found.evidences}
    assert "noise some" in refused["surface_phases",]


def test_two_laws_of_contact_are_no_explanation(tmp_path):
    problem = drops_problem(datasets.read_drops(write_drops(tmp_path / "data")))
    assert problem.combine(PAIR).possible
    assert not problem.combine(("plastic_contact", "adhesion")).possible
    assert not problem.combine(("contact_damping", "stiffening_contact")).possible


def test_chance_is_met_in_the_mean_and_in_the_square():
    effects = [EFFECTS["surface_phases"](), EFFECTS["surface_slope"](), EFFECTS["wear"]()]
    nodes, weights = chances(effects)
    assert weights.sum() == pytest.approx(1.0)
    stiff = np.array([node[0][0] for node in nodes])
    thin, wide = (np.array([node[1][i] for node in nodes]) for i in (0, 1))
    assert weights @ stiff == pytest.approx(0.0, abs=1e-12)
    assert weights @ stiff**4 == pytest.approx(3.0)
    assert weights @ thin**2 == pytest.approx(1.0)
    assert weights @ wide**2 == pytest.approx(1.0)


def test_drops_that_are_numbered_by_their_date_wear_to_an_end(tmp_path):
    folder = write_drops(tmp_path / "data")
    table = (folder / "drops.csv").read_text()
    (folder / "drops.csv").write_text(table.replace(f"\n{COUNT},", "\n20261121,"))
    problem = drops_problem(datasets.read_drops(folder))
    (wear,) = [each for each in problem.candidates if each.effects == ("wear",)]
    for decades in (wear.parameters[1].low, wear.parameters[1].high):
        with np.errstate(all="raise"):
            predicted = wear.predict(np.array([2e6, decades]))
        assert np.isfinite(predicted).all()


def test_a_direction_that_data_cannot_see_is_named(quick, tmp_path):
    problem = drops_problem(datasets.read_drops(write_drops(tmp_path / "data")))
    rows = np.arange(len(problem.values))
    unit = np.ones(len(rows))
    (own,) = directions(problem.baseline, [2e6], rows, unit)
    assert own.seen
    assert own.words(["kn_N_m"]) == "1.00 kn_N_m"
    found = directions(problem.baseline, [2e6], rows, 1e-9 * unit)
    assert not found[0].seen
    assert found[0].deviation == pytest.approx(1.0 / math.sqrt(12.0))


def test_a_folder_without_declarations_is_told_what_to_do(tmp_path):
    (tmp_path / "drops.csv").write_text("drop,y0_mm,y1_mm\n1,10,6\n")
    said = refused("close-loop", tmp_path, "--out", tmp_path / "out")
    assert said.startswith(f"{tmp_path / 'dataset.toml'}: is missing")
    assert "docs/measurements.md" in said
    nowhere = tmp_path / "nowhere"
    said = refused("close-loop", nowhere, "--out", tmp_path / "out")
    assert said == f"{nowhere}: there is no such folder"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("drop,y0_mm,y1_mm\n1,10,6\n2,20,x\n3,30,19\n", "drops.csv:3: y1_mm is no number: 'x'"),
        ("drop,y0_mm,y1_mm\n1,10,6\n2,20,13\n3,30,19\n", "the loop needs four or more"),
        (
            "drop,y0_mm,y1_mm\n1,10,6\n2,20,6\n3,30,6\n4,40,6\n",
            "drops.csv: y1_mm is 6 in every drop, whatever y0_mm; is the reading stuck?",
        ),
        (None, "drops.csv: no such file"),
    ],
)
def test_a_wrong_dataset_ends_with_2_and_leaves_nothing_behind(tmp_path, table, words):
    (tmp_path / "dataset.toml").write_text("[dataset]\nkind = 'drops'\n")
    if table is not None:
        (tmp_path / "drops.csv").write_text(table)
    before = sorted(tmp_path.iterdir())
    assert words in refused("close-loop", tmp_path, "--out", tmp_path / "new" / "out")
    assert sorted(tmp_path.iterdir()) == before


def test_wrong_options_end_with_2(worn, tmp_path, capsys):
    dataset, _ = worn
    for options, words in (
        (["--alarm", "2"], "--alarm: must be less than or equal to 0.3"),
        (["--seed", "-1"], "--seed: must be greater than or equal to 0"),
        (["--out", str(dataset / "drops.csv")], "is a file, not a folder"),
    ):
        assert main(["close-loop", str(dataset), *options]) == 2
        assert words in capsys.readouterr().err.splitlines()[-1]


def test_a_loop_that_fails_ends_with_1_and_keeps_what_was_there(worn, tmp_path, monkeypatch):
    def fail(*arguments):
        raise ComputationError("no")

    dataset, _ = worn
    kept = tmp_path / "kept"
    kept.mkdir()
    write_atomically(kept / "verdict.json", "earlier")
    monkeypatch.setattr(close_loop_study, "find", fail)
    for out in (kept, tmp_path / "new" / "out"):
        assert main(["close-loop", str(dataset), "--out", str(out)]) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]
    assert (kept / "verdict.json").read_text() == "earlier"


def measured(name: str) -> Path:
    if not (DATA / name / "dataset.toml").is_file():
        pytest.skip(f"{name} is not in {DATA}: the README says where anyone can get it")
    return DATA / name


def test_the_measured_bar_lacks_its_damping_and_the_solid_confirms_it(tmp_path):
    dataset = MEASURED / "square-bar"
    done = commands.mpirun(
        2, "-m", "bristle.studies.close_loop", dataset, "--out", tmp_path / "out"
    )
    assert done.returncode == 0, done.stderr
    content = read_strictly(tmp_path / "out" / "verdict.json")
    assert content["verdict"] in ("effect", "ambiguous", "unknown")
    assert content["detection"]["p_value"] < 0.03
    if content["verdict"] == "effect":
        beta = content["parameters"]["beta_s"]
        assert beta["low"] < README_BETA_S < beta["high"]
        assert "material_damping" in content["effects"]
        for errors in (content["held_out"], content["confirmed_in_3d"]):
            assert errors["rms_after"] < 0.14 * errors["rms_before"]


def test_the_measured_falls_meet_the_air(tmp_path):
    done = commands.bristle("close-loop", MEASURED / "falls-phone", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    content = read_strictly(tmp_path / "out" / "verdict.json")
    assert content["detection"]["p_value"] < 0.03
    assert content["verdict"] == "effect"
    assert {"air_drag"} <= set(content["effects"]) <= {"air_drag", "drag_scatter"}
    assert content["confirmed_in_3d"] is None
    assert "does not touch" in content["confirmed_in_3d_why"]
    assert content["held_out"]["rms_after"] < 0.17 * content["held_out"]["rms_before"]
