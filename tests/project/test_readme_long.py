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
LEAN_DEG, KN_N_M, DROPS, SEED = 3.0, 2e6, 40, 5
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
def test_the_walk_from_a_film_ends_with_the_verdict_that_is_shown(
    name, tmp_path, monkeypatch, capsys
):
    (session,) = [each for each in readme.sessions() if name in each.words]
    film(name, tmp_path)
    monkeypatch.chdir(tmp_path)
    assert main(list(session.words[1:])) == 0
    assert readme.compare(session, capsys.readouterr().out) == []


def test_the_first_result_and_the_picture_on_top(tmp_path, monkeypatch, capsys):
    session = readme.sessions()[0]
    assert "solid" in session.words
    monkeypatch.chdir(tmp_path)
    assert main(list(session.words[1:])) == 0
    assert readme.compare(session, capsys.readouterr().out) == []
    assert main(["view", "results/drop"]) == 0
    (name,) = re.findall(r"!\[[^]]+\]\(([^)]+)\)", readme.TEXT)
    shown = imread(readme.REPOSITORY / name)[..., :3]
    now = imread(tmp_path / "results" / "drop" / "view" / "wave.png")[..., :3]
    assert shown.shape == now.shape
    assert np.abs(shown - now).mean() < 0.01
    (times,) = re.findall(r"displacements (\d+) times as large", readme.TEXT)
    assert f"displacement × {times}" in Path("results/drop/view/wave.svg").read_text()


def test_the_table_of_leaning_and_what_is_said_of_it():
    rows = Campaign().rows(MPI.COMM_SELF)
    at = {(row["height_mm"], row["friction"], row["lean_deg"]): row for row in rows}
    for lean, *shown in readme.table("lean |"):
        row = at[50.0, 0.0, float(lean.rstrip("°"))]
        for name, number in zip(COLUMNS, shown, strict=True):
            assert readme.agree(number, row[name]), (lean, name)
    off = {key: abs(row["second_off"]) for key, row in at.items()}
    assert max(off[50.0, 0.0, lean] for lean in (0.5, 1.0, 2.0)) < 5e-4
    assert off[50.0, 0.0, 5.0] < 1e-3
    assert off[10.0, 0.0, 2.0] < 5e-3
    assert off[10.0, 0.0, 5.0] < 0.04
    assert 0.075 < at[50.0, 0.0, 2.0]["linear_off"] < 0.085
    leans = [0.5, 1.0]
    linear = [at[50.0, 0.0, lean]["linear_off"] for lean in leans]
    # as the square of the lean
    assert 0.55 < float(np.interp(0.1, np.sqrt(linear), leans)) < 0.68
    (together,) = map(float, re.findall(r"agree\s+within ([\d.]+) % up to 5°", readme.TEXT))
    for (_, friction, _), row in at.items():
        if friction > 0.0:
            models = [row[name] for name in ("beam_linear", *COLUMNS[:3])]
            assert max(abs(kept - row["finite"]) for kept in models) < 0.01 * together


def test_what_the_change_to_linear_flight_leaves_over():
    number = r"(\d\S*e-\d)"
    told = re.search(
        rf"at 2°, from 50 mm without friction, {number} for the beam, {number} for the solid and "
        rf"{number} for the reduced solid; at 5° {number}, {number} and {number}",
        " ".join(readme.TEXT.split()),
    )
    assert told is not None
    cases = [(model, lean) for lean in (2.0, 5.0) for model in ("beam", "solid", "reduced")]
    for (model, lean), shown in zip(cases, told.groups(), strict=True):
        drop = {"model": model, "tilt_deg": lean, "elements": ELEMENTS, "beta_s": 1e-8}
        drop |= {"friction": 0.0, "height_m": 0.05, "until": "impact"}
        energy = run_case(checked(DropInputs, drop))[0].energy
        assert readme.agree(shown, abs(energy.numerical_J) / energy.initial_J), (model, lean)


def test_what_a_rigid_plane_gives_back():
    told = re.search(
        r"comes back to ([\d.]+) of it at `--its 1e-6` and to ([\d.]+) at 1e-7 by Nitsche's "
        r"method, to ([\d.]+) at 1e-6 by the augmented Lagrangian",
        " ".join(readme.TEXT.split()),
    )
    assert told is not None
    ways = (("nitsche", 1e-6), ("nitsche", 1e-7), ("augmented", 1e-6))
    for (contact, its_s), shown in zip(ways, told.groups(), strict=True):
        rigid = {"contact": contact, "its_s": its_s, "kn_N_m": math.inf, "beta_s": 0.0}
        ratio = run_case(checked(DropInputs, rigid))[0].rebound_ratio
        assert readme.agree(shown, ratio), contact


def test_what_it_found(tmp_path):
    done = run_reproduce(tmp_path, comm=MPI.COMM_SELF)
    text = readme.TEXT.split("## What it found")[1].split("## Architecture")[0]
    text = " ".join(text.split())
    tables = done.report.parent / "tables"
    ratios = {
        float(row["kn_MN_m"]): float(row["ratio_1d"])
        for row in found("fig13_ratios.csv", tables)
        if float(row["y0_mm"]) == 50.0
    }
    told = re.search(r"y1/y0 = ([\d.]+), ([\d.]+) and ([\d.]+) at Kn = ([\d.]+), (\d+) and", text)
    assert told is not None
    for number, kn in zip(told.groups()[:3], (0.01, 2.0, 100.0), strict=True):
        assert readme.agree(number, ratios[kn])
    apart = max(float(row["apart"]) for row in found("fig13_ratios.csv", tables))
    assert "4·10⁻⁵ at most" in text
    assert 3e-5 < apart < 4e-5
    rigid = float(found("rigid_plane.csv", tables)[0]["rebound_ratio"])
    assert readme.agree(re.findall(r"leaves y1/y0 = ([\d.]+),", text)[0], rigid)
    eq8 = {float(row["kn_MN_m"]): row for row in found("eq8.csv", tables)}[100.0]
    after, instead = re.findall(r"after ([\d.]+) ms instead of ([\d.]+)\.", text)[0]
    assert readme.agree(after, 1e-3 * float(eq8["tp_beam_us"]))
    assert readme.agree(instead, 1e-3 * float(eq8["tp_rule_us"]))
    page = done.report.read_text()
    for number in re.findall(r"\(([\d.]+) % off at worst\)|: (\d+) % off at", text):
        assert any(f"{each}" in page for each in number if each)
    differing = [c.quantity for s in done.sections for c in s.comparisons if c.verdict == "differs"]
    assert len(differing) == 3


@pytest.mark.parametrize("row", readme.table("material damping, friction, lean")[1:], ids=str)
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
        likely = [float(p) for p in re.findall(r"p from ([\d.]+) to ([\d.]+)", readme.TEXT)[0]]
        found = [each["p_value"] for each in document["samples_of_26"].values()]
        assert readme.agree(f"{likely[0]:.1f}", min(found))
        assert readme.agree(f"{likely[1]:.1f}", max(found))


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
