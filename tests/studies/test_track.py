"""`bristle track`: the dataset, its page and pictures, doubts, and what the loop makes of it."""

import json
import re
from pathlib import Path

import av
import numpy as np
import pandas as pd
import pytest
import readme
from commands import bristle as command

import bristle
from bristle.solver.errors import InputError
from bristle.studies.film.render import Flown, Look, bouncing, write_film
from bristle.studies.loop.kinds.tracks.record import read_tracks

pytestmark = pytest.mark.serial
FOUR = readme.REPOSITORY / "docs" / "gallery" / "data" / "four-drops.mp4"


@pytest.fixture(scope="module")
def four(tmp_path_factory):
    """The command on the film that comes with the program: what it printed, and its folder."""
    folder = tmp_path_factory.mktemp("track") / "four"
    done = command("track", FOUR, "--out", folder)
    assert done.returncode == 0, done.stderr
    return done.stdout, folder


def test_it_prints_what_the_documents_show(four):
    page = (readme.REPOSITORY / "docs" / "films.md").read_text()
    shown = re.search(r"\$ docker/run bristle track .*?\n(.*?)```", page, re.DOTALL)[1]
    printed = four[0].replace(str(four[1]), "results/four")
    assert printed.split() == shown.split()


def test_the_dataset_is_one_that_the_loop_reads(four):
    folder = four[1]
    data = read_tracks(folder)
    assert len(data.pieces) == 4
    table = pd.read_csv(folder / "tracks.csv")
    assert {"drop", "t_s", "y_mm", "sigma_mm", "lean_deg"} <= set(table)
    # each row is as uncertain as the table says
    assert np.allclose(1e3 * data.sigma_y_m * data.relative, table.sigma_frame_mm, rtol=1e-6)
    assert float(data.manifest.measurement["sigma_scale"]) > 0.0
    first = table.groupby("drop").y_mm.first()
    assert first.to_numpy() == pytest.approx([41.0, 28.5, 48.2, 19.3], abs=0.25)


def test_the_page_and_the_overlay_show_every_drop(four):
    folder = four[1]
    page = (folder / "report.html").read_text()
    for number in range(1, 5):
        assert f"Drop {number}, four-drops.mp4" in page
        assert (folder / "figures" / f"frames-{number}.png").exists()
    (film,) = (folder / "overlays").iterdir()
    with av.open(str(film)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    document = json.loads((folder / "track.json").read_text())
    assert len(frames) >= sum(drop["frames_used"] for drop in document["drops"])
    red = [(frame[..., 0].astype(int) - frame[..., 2] > 60).sum() for frame in frames]
    assert np.median(red) > 5


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """A short film of one drop, 120 frames a second, made by our renderer."""
    height, until = bouncing(0.03, 0.03 * 0.75**2, 3e-4, 9.8, held_s=0.1, bounces=1)
    path = tmp_path_factory.mktemp("track") / "one.mp4"
    look = Look(fps=120.0, mm_per_px=1.09, columns=96)
    write_film(path, Flown(height, until), look, np.random.default_rng(1))
    return path


def test_from_python_nothing_is_written(one, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = bristle.track(one)
    assert (found.unit, len(found.drops), found.folder) == ("mm", 1, None)
    assert found.drops[0].restitution[0].low < 0.75 < found.drops[0].restitution[0].high
    assert list(found.table.groupby("drop").size()) == [d.frames_used for d in found.drops]
    found.plot()
    assert not list(tmp_path.iterdir())


def test_a_wrong_number_of_frames_a_second_is_said(one):
    # a telephone's slow motion: filmed at 120, played at 30
    found = bristle.track(one, fps=30)
    assert any("give --fps 120" in doubt for doubt in found.warnings)


def test_without_a_scale_heights_are_in_pixels(one, tmp_path):
    # the lower part of the bristle alone, in which nothing has a known length
    with av.open(str(one)) as film:
        width, height = film.streams.video[0].width, film.streams.video[0].height
    part = (0, height - 150, width, 150)
    found = bristle.track(one, roi=part, out=tmp_path / "px")
    assert found.unit == "px"
    assert "--mm-per-px" in found.warnings[0]
    command = f"bristle track {one} --roi {' '.join(map(str, part))} --out {tmp_path / 'px'}"
    assert command in (tmp_path / "px" / "report.html").read_text()
    assert {"y_px", "sigma_px"} <= set(pd.read_csv(tmp_path / "px" / "tracks.csv"))
    scaled = bristle.track(one, roi=part, mm_per_px=1.09)
    both = found.table.merge(scaled.table, on=["drop", "frame"])
    assert len(both) > 0.9 * len(found.table)
    # a given scale and what falls show of it agree, and their mean is used
    used = scaled.films[0].mm_per_px
    assert used == pytest.approx(1.09, rel=2e-3)
    # a scale says where gravity puts the surface, so the zero may be another, but is one for all
    apart = used * both.y_px - both.y_mm
    assert np.ptp(apart) < 1e-3
    assert abs(apart.mean()) < 1.645 * 1.09 * both.sigma_px.mean()


def test_a_film_in_which_nothing_falls_ends_with_status_2(tmp_path):
    height, _ = bouncing(0.02, 0.01, 0.0, 9.8, held_s=9.0)
    path = tmp_path / "still.mp4"
    write_film(path, Flown(height, 0.3), Look(), np.random.default_rng(0))
    done = command("track", path, "--out", tmp_path / "out")
    assert done.returncode == 2
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith(f"bristle: error: {path}: no bristle that falls")
    assert not (tmp_path / "out").exists()


def test_a_ball_has_no_length():
    with pytest.raises(InputError, match="is for body bristle"):
        bristle.track(FOUR, body="ball", length_mm=300.0)


def test_the_pictures_that_are_read_are_not_written_over(tmp_path):
    folder = Path(tmp_path)
    with pytest.raises(InputError, match="is the folder of pictures that is read"):
        bristle.track(folder, fps=10.0, out=folder)


@pytest.mark.campaign
@pytest.mark.timeout(900)
def test_the_verdict_is_the_one_that_the_documents_show(four, tmp_path):
    page = (readme.REPOSITORY / "docs" / "films.md").read_text()
    shown = re.search(r"\$ docker/run bristle close-loop .*?\n(verdict +\w+)\n", page)[1]
    assert bristle.close_loop(four[1]).verdict == shown.split()[1]


@pytest.mark.campaign
def test_an_effect_in_made_films_is_found_again(tmp_path):
    """Effect, film, track, verdict."""
    made = bristle.synth(
        film=True, drops=8, effects=["contact_damping:c_N_s_m=4"], seed=3, out=tmp_path / "made"
    )
    made.plot()
    films = sorted((tmp_path / "made" / "films").iterdir())
    assert len(films) == 8
    found = bristle.track(films, out=tmp_path / "tracks")
    heights = found.table.groupby("drop").y_mm.first().to_numpy()
    # what the table of a dataset would have had, read without error
    assert heights == pytest.approx(made.table.y0_mm.to_numpy(), rel=0.005, abs=0.15)
    kept = np.array([drop.restitution[0].estimate for drop in found.drops])
    assert kept == pytest.approx(np.sqrt(made.table.y1_mm / made.table.y0_mm), abs=0.008)
