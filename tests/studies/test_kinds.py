"""Kinds of data from outside: a user's file and installed packages."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from made_drops import SIGMA_S, write_drops

import bristle
from bristle.solver.effects.library import EFFECTS
from bristle.solver.errors import InputError
from bristle.studies.cli import main
from bristle.studies.close_loop.run import problem_of
from bristle.studies.data.datasets import read_drops, read_manifest
from bristle.studies.inputs import kinds
from bristle.studies.inputs.kinds import KINDS

pytestmark = pytest.mark.serial
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "my_kind.py"


def write_closures(folder, effects=()):
    """Contact times of made drops as a dataset of the example's kind."""
    drops = read_drops(write_drops(folder / "drops", effects, forces=True))
    out = folder / "closures"
    out.mkdir()
    (out / "dataset.toml").write_text(
        '[dataset]\ntitle = "Circuits"\nkind = "closures"\n'
        f'[measurement]\nfile = "closures.csv"\nsigma_t_s = {SIGMA_S}\n'
    )
    columns = zip(drops.drop, 1e3 * drops.y0_m, 1e6 * drops.contact_time_s, strict=True)
    lines = [f"{int(drop)},{y0:.4f},{closed:.4f}" for drop, y0, closed in columns]
    (out / "closures.csv").write_text("\n".join(["drop,y0_mm,closed_us", *lines]) + "\n")
    return out


@pytest.fixture(autouse=True)
def _forgotten():
    with kinds.forgotten_afterwards():
        yield


@pytest.fixture
def plugin(tmp_path):
    """The example with two of its effects, whose tables take no minutes."""
    text = EXAMPLE.read_text()
    every = next(line for line in text.splitlines() if line.startswith("EFFECTS = "))
    path = tmp_path / "my_kind.py"
    path.write_text(text.replace(every, 'EFFECTS = ("contact_damping", "wear")'))
    return path


def test_the_loop_closes_on_a_kind_of_ones_own(tmp_path, plugin):
    data = write_closures(tmp_path, [EFFECTS["wear"](decades=-0.5)])
    out = tmp_path / "out"
    asked = ["close-loop", str(data), "--plugin", str(plugin), "--out", str(out), "--no-3d"]
    assert main(asked) == 0
    found = json.loads((out / "verdict.json").read_text())
    assert (found["verdict"], found["effects"]) == ("effect", ["wear"])
    told = found["parameters"]["decades"]
    assert abs(told["estimate"] + 0.5) < told["high"] - told["low"]
    assert found["held_out"]["rms_after"] < 0.5 * found["held_out"]["rms_before"]
    assert found["kind"] == "closures"
    assert "closures" in (out / "report.html").read_text()


def test_a_kind_is_known_inside_a_call_alone(tmp_path, plugin):
    data = write_closures(tmp_path)
    found = bristle.close_loop(data, plugins=[str(plugin)], no_3d=True)
    assert found.verdict == "adequate"
    assert "closures" not in KINDS
    with pytest.raises(InputError, match=r"dataset.toml:3: kind must be one of drops, .*closures"):
        bristle.close_loop(data, no_3d=True)


def test_a_kind_that_is_none_is_refused_by_its_line(tmp_path, plugin):
    data = write_closures(tmp_path)
    plugin.write_text(plugin.read_text().replace('Kind("closures"', 'Kind("drops"'))
    with pytest.raises(InputError, match="there is a kind drops of data already"):
        bristle.close_loop(data, plugins=[str(plugin)], no_3d=True)
    plugin.write_text(plugin.read_text().replace('Kind("drops"', 'Kind("two words"'))
    with pytest.raises(InputError, match="a kind's name is of small letters"):
        bristle.close_loop(data, plugins=[str(plugin)], no_3d=True)
    plugin.write_text('from bristle.studies.inputs.kinds import Kind\nK = Kind("closures", str)\n')
    with pytest.raises(InputError, match="dataset.toml:3: kind is closures, whose function"):
        bristle.close_loop(data, plugins=[str(plugin)], no_3d=True)


def test_an_installed_package_brings_its_kind(tmp_path, monkeypatch):
    data = write_closures(tmp_path)
    monkeypatch.setattr(kinds, "KINDS", dict(KINDS))
    monkeypatch.setattr("bristle.studies.data.datasets.KINDS", kinds.KINDS)
    monkeypatch.setattr("bristle.studies.close_loop.run.KINDS", kinds.KINDS)
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    for value in ("my_kind:closures", "my_kind:nothing"):
        point = EntryPoint("closures", value, kinds.ENTRY_POINT)
        monkeypatch.setattr(kinds, "entry_points", lambda group, point=point: [point])
        kinds.KINDS.pop("closures", None)
        kinds.load_installed.cache_clear()
        manifest = read_manifest(data)
        if value.endswith("nothing"):
            with pytest.raises(InputError, match="is closures, which cannot be loaded"):
                problem_of(manifest)
        else:
            problem = problem_of(manifest)
            assert problem.unit == "µs"
            assert np.all(problem.quantity == "contact time (µs)")
    kinds.load_installed.cache_clear()
