"""The README's numbers that take minutes are true, and its long commands end well.

Left out are `bench` and what it takes an hour to do: those numbers are timings, or the next run of
the benchmark's.
"""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path

import film_data
import numpy as np
import pytest
import readme
from commands import bristle, mpirun
from large_rotation import ELEMENTS, Campaign
from matplotlib.image import imread
from mpi4py import MPI

from bristle.studies.cli import main
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.sources import checked
from bristle.studies.reproduce.run import run_reproduce
from bristle.studies.running.cases import run_case

pytestmark = [pytest.mark.serial, pytest.mark.campaign, pytest.mark.timeout(3600)]

FILMS = {"my-drops": 25.0, "my-drops-again": 250.0}
LEAN_DEG, KN_N_M, DROPS, SEED = 3.0, 2e6, 40, 470770
# README's names of the columns of large-rotation.csv, by place.
COLUMNS = ("solid_linear", "beam_second", "solid_second", "finite")
LONG = (
    ("drop", "--model", "solid", "--contact"),
    ("drop", "--diameter"),
    ("drop", "--model", "solid", "--effect"),
)
# One of its commands a rank count, small enough for two cores; the others have the same code.
RANKED = (("python3", "-m", "bristle.studies.sweep"),)


def found(name: str, folder: Path) -> list[dict[str, str]]:
    with (folder / name).open(newline="") as file:
        return list(csv.DictReader(file))


def film(name: str, folder: Path) -> None:
    """The made-up drops of the README's walk, as filmed at the rate of ``name``."""
    rng = np.random.default_rng(SEED)
    scenes = film_data.scenes(DROPS, KN_N_M, {"bristle_tilt": LEAN_DEG}, rng)
    films = [film_data.film(scene, rng, fps=FILMS[name]) for scene in scenes]
    film_data.write(folder / name, films, "")
    declared = readme.blocks("toml")[0]
    assert "fps = 25\n" in declared
    declared = declared.replace("fps = 25\n", f"fps = {FILMS[name]}\n")
    (folder / name / "dataset.toml").write_text(declared)


@pytest.mark.parametrize("name", FILMS)
def test_the_walk_from_a_film_ends_with_the_verdict_that_is_shown(name, tmp_path):
    (session,) = [each for each in readme.sessions() if name in each.words]
    film(name, tmp_path)
    assert readme.run(session, tmp_path) == []


def test_the_first_result_and_the_picture_on_top(tmp_path, monkeypatch):
    session = readme.sessions()[0]
    assert "solid" in session.words
    assert readme.run(session, tmp_path) == []
    monkeypatch.chdir(tmp_path)
    assert main(["view", "results/drop"]) == 0
    (name,) = re.findall(r"!\[[^]]+\]\(([^)]+)\)", readme.TEXT)
    shown = imread(readme.REPOSITORY / name)[..., :3]
    now = imread(tmp_path / "results" / "drop" / "view" / "wave.png")[..., :3]
    assert shown.shape == now.shape
    assert np.abs(shown - now).mean() < 0.01
    scale = readme.number("wave-scale")
    assert f"displacement × {scale}" in Path("results/drop/view/wave.svg").read_text()


def test_the_table_of_leaning_and_what_is_said_of_it():
    rows = Campaign().rows(MPI.COMM_SELF)
    at = {(row["height_mm"], row["friction"], row["lean_deg"]): row for row in rows}
    for lean, *shown in readme.table("leaning"):
        row = at[50.0, 0.0, float(lean.rstrip("°"))]
        for name, number in zip(COLUMNS, shown, strict=True):
            assert readme.agree(number, row[name]), (lean, name)
    off = {key: abs(row["second_off"]) for key, row in at.items()}
    told = {
        name: 0.01 * float(readme.number(name))
        for name in ("second-order-off-2", "second-order-off-5", "linear-off-2", "friction-agrees")
    }
    assert max(off[50.0, 0.0, lean] for lean in (0.5, 1.0, 2.0)) < told["second-order-off-2"]
    assert off[50.0, 0.0, 5.0] < told["second-order-off-5"]
    assert off[10.0, 0.0, 2.0] < 5e-3
    assert off[10.0, 0.0, 5.0] < 0.04
    assert abs(at[50.0, 0.0, 2.0]["linear_off"] - told["linear-off-2"]) < 0.005
    leans = [0.5, 1.0]
    linear = [at[50.0, 0.0, lean]["linear_off"] for lean in leans]
    # as the square of the lean
    lean = float(np.interp(0.1, np.sqrt(linear), leans))
    assert -0.05 < lean - float(readme.number("linear-one-percent-lean")) < 0.08
    for (_, friction, _), row in at.items():
        if friction > 0.0:
            models = [row[name] for name in ("beam_linear", *COLUMNS[:3])]
            assert max(abs(kept - row["finite"]) for kept in models) < told["friction-agrees"]


def test_what_the_change_to_linear_flight_leaves_over():
    models = ("beam", "solid", "reduced")
    for lean, *shown in readme.table("flight-left-over"):
        for model, number in zip(models, shown, strict=True):
            drop = {"model": model, "tilt_deg": float(lean.rstrip("°")), "elements": ELEMENTS}
            drop |= {"beta_s": 1e-8, "friction": 0.0, "height_m": 0.05, "until": "impact"}
            energy = run_case(checked(DropInputs, drop))[0].energy
            left_over = abs(energy.numerical_J) / energy.initial_J
            assert readme.agree(number, left_over), (model, lean)


def test_what_a_rigid_plane_gives_back():
    ways = {
        "rigid-nitsche": ("nitsche", 1e-6),
        "rigid-nitsche-fine": ("nitsche", 1e-7),
        "rigid-augmented": ("augmented", 1e-6),
    }
    for name, (contact, its_s) in ways.items():
        rigid = {"contact": contact, "its_s": its_s, "kn_N_m": math.inf, "beta_s": 0.0}
        ratio = run_case(checked(DropInputs, rigid))[0].rebound_ratio
        assert readme.agree(readme.number(name), ratio), contact


def test_what_it_found(tmp_path):
    done = run_reproduce(tmp_path, comm=MPI.COMM_SELF)
    tables = done.report.parent / "tables"
    ratios = {
        float(row["kn_MN_m"]): float(row["ratio_1d"])
        for row in found("fig13_ratios.csv", tables)
        if float(row["y0_mm"]) == 50.0
    }
    for name, kn in {"ratio-soft": 0.01, "ratio-chosen": 2.0, "ratio-stiff": 100.0}.items():
        assert readme.agree(readme.number(name), ratios[kn])
    apart = max(float(row["apart"]) for row in found("fig13_ratios.csv", tables))
    at_most = float(readme.number("beam-and-solid-apart"))
    assert 0.75 * at_most < apart < at_most
    rigid = float(found("rigid_plane.csv", tables)[0]["rebound_ratio"])
    assert readme.agree(readme.number("rigid-plane-damped"), rigid)
    eq8 = {float(row["kn_MN_m"]): row for row in found("eq8.csv", tables)}[100.0]
    assert readme.agree(readme.number("greatest-penetration-ms"), 1e-3 * float(eq8["tp_beam_us"]))
    assert readme.agree(readme.number("eq8-ms"), 1e-3 * float(eq8["tp_rule_us"]))
    page = done.report.read_text()
    assert readme.number("its-ratio-off") in page
    assert readme.number("its-force-off") in page
    differing = [c.quantity for s in done.sections for c in s.comparisons if c.verdict == "differs"]
    assert len(differing) == 3


@pytest.mark.parametrize("row", readme.table("scatter")[1:], ids=str)
def test_scatter_is_as_the_table_says(row, tmp_path):
    what, ratio, band, inside = row
    beta, friction, lean = re.findall(r"β = ([\de.-]+) s, ([\d.]+), ([\d.]+)°", what)[0]
    command = ["scatter", "--beta", beta, "--friction", friction, "--tilt-std", lean]
    assert main([*command, "--out", str(tmp_path)]) == 0
    document = json.loads((tmp_path / "scatter.json").read_text())
    said = document["statistics"]
    mean, spread = ratio.split(" ± ")
    low, high = band.split(" to ")
    assert readme.agree(mean, said["mean"]["estimate"])
    assert readme.agree(spread, said["std"]["estimate"])
    assert readme.agree(low, said["percentiles"]["p5"]["estimate"])
    assert readme.agree(high, said["percentiles"]["p95"]["estimate"])
    share = 100.0 * said["share_in_0.30_to_1.00"]["estimate"]
    assert readme.agree(inside.removesuffix(" %"), share)
    if (lean, friction) == ("2", "0"):
        found = [each["p_value"] for each in document["samples_of_26"].values()]
        assert readme.agree(readme.number("sample-p-low"), min(found))
        assert readme.agree(readme.number("sample-p-high"), max(found))


@pytest.mark.parametrize(
    "words",
    [
        words
        for words in dict.fromkeys(readme.commands())
        if any(words[1 : 1 + len(each)] == each for each in LONG)
        or any(readme.without_ranks(words)[1][: len(each)] == each for each in RANKED)
    ],
    ids=" ".join,
)
def test_long_commands_end_well(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ranks, own = readme.without_ranks(words)
    done = mpirun(ranks, *own[1:], timeout_s=3000.0) if ranks > 1 else bristle(*own[1:])
    assert done.returncode == 0, done.stderr
    # where its results are stands first or last
    lines = done.stdout.splitlines()
    names = [line.split()[-1] for line in [*lines[:1], *lines[-3:]] if line.split()]
    assert any((tmp_path / name).is_file() for name in names)
