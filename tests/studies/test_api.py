"""The Python interface: the command's answers by name, in one process and in several."""

from __future__ import annotations

import json
import logging
import math
import pickle

import numpy as np
import pandas as pd
import pytest
from commands import mpirun, python
from made_drops import QUICK, write_drops

import bristle
from bristle.solver.effects.library import EFFECTS
from bristle.studies.cli import main
from bristle.studies.loop.kinds.drops import problem as drops_module
from bristle.studies.running.mark import MARK

pytestmark = pytest.mark.serial

LEANING = {"model": "solid", "tilt_deg": 2, "friction": 0, "cells": (1, 2, 24), "length_m": 0.05}
# What differs from run to run, and what a folder alone has.
OWN = {"wall_s", "peak_rss_MB", "mark"}


def test_a_drop_is_that_of_the_command(tmp_path):
    found = bristle.drop(**LEANING)
    options = "--model solid --tilt 2 --friction 0 --cells 1 2 24 --length 0.05 --no-fields"
    assert main(["drop", *options.split(), "--out", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "result.json").read_text())
    written["inputs"]["write_fields"] = True
    alike = {name for name in written if name not in OWN}
    assert {name: written[name] for name in alike} == {
        name: json.loads(json.dumps(found.to_dict()))[name] for name in alike
    }
    assert found.rebound_ratio == found["rebound_ratio"]
    assert found.inputs.tilt_deg == 2.0
    assert found.energy.kinetic_J == found["energy"]["kinetic_J"] > 0.0
    pd.testing.assert_frame_equal(found.history, pd.read_csv(tmp_path / "history.csv"))
    assert "rebound ratio y1/y0" in repr(found)
    assert "rebound_ratio" in dir(found)


def test_a_drop_with_a_folder_leaves_the_commands_files(tmp_path):
    found = bristle.drop(
        model="beam", out=tmp_path, kn_N_m=np.float64(1e5), cells=np.array([1, 2, 3])
    )
    assert found.inputs.cells == [1, 2, 3]
    assert found.to_dict() == json.loads((tmp_path / "result.json").read_text())
    again = pickle.loads(pickle.dumps(found))
    assert again.rebound_ratio == found.rebound_ratio
    pd.testing.assert_frame_equal(again.history, found.history)


def test_wrong_inputs_are_named_as_they_were_given():
    with pytest.raises(bristle.InputError, match=r"^kn_N_m: must be greater"):
        bristle.drop(kn_N_m=-1.0)
    with pytest.raises(bristle.InputError, match=r"^knn: is no known input"):
        bristle.drop(knn=1.0)
    with pytest.raises(bristle.InputError, match=r"^tilt: .*; did you mean tilt_deg"):
        bristle.drop(tilt=2.0)
    with pytest.raises(bristle.InputError, match=r"^height_m: given twice, also as heights_m"):
        bristle.sweep(height_m=0.05, heights_m=0.05)
    with pytest.raises(bristle.InputError, match=r"^out: must be a folder"):
        bristle.drop(model="beam", out="")
    with pytest.raises(AttributeError, match="rebound_ratio"):
        _ = bristle.drop(model="analytic").rebound
    with pytest.raises(AttributeError, match="no attribute 'drops'"):
        bristle.drops()


def test_a_sweep_is_a_table(tmp_path):
    asked = {"models": ["beam", "analytic"], "kn_N_m": [1e5, 2e6], "height_m": 0.05}
    table = bristle.sweep(**asked)
    assert list(table["model"]) == ["analytic", "analytic", "beam", "beam"]
    one = bristle.drop(model="beam", kn_N_m=2e6)
    assert table["rebound_ratio"].iloc[-1] == one.rebound_ratio
    written = bristle.sweep(**asked, out=tmp_path)
    pd.testing.assert_frame_equal(table.drop(columns="wall_s"), written.drop(columns="wall_s"))
    assert (tmp_path / "sweep.json").exists()
    ended = bristle.sweep(models="beam", kn_N_m=2e6, height_m=0.05, until="impact")
    assert math.isnan(ended["rebound_ratio"].iloc[0])


def test_the_loop_gives_the_verdict_of_the_command(tmp_path, monkeypatch):
    monkeypatch.setattr(drops_module, "carried", lambda kind, quantities: list(QUICK))
    dataset = write_drops(tmp_path / "data", [EFFECTS["wear"](decades=2.0)], "worn")
    found = bristle.close_loop(dataset, seed=3, no_3d=True)
    written = bristle.close_loop(str(dataset), seed=3, no_3d=True, out=tmp_path / "out")
    assert found.effects == ["wear"]
    assert written == {**found, "mark": MARK}
    assert written.to_dict() == json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert found.held_out.rms_after < found.held_out.rms_before
    assert "wear" in repr(found)


def test_warnings_are_logged_and_nothing_is_printed(capsys, caplog):
    with caplog.at_level(logging.WARNING, logger="bristle"):
        found = bristle.drop(model="beam", its_s=1e-4, until="impact")
    assert found.warnings
    assert [record.getMessage() for record in caplog.records] == found.warnings
    assert capsys.readouterr() == ("", "")


def test_to_import_it_loads_nothing_that_computes():
    heavy = {"numpy", "numba", "mpi4py", "pydantic", "pandas"}
    done = python("-c", f"import sys, bristle; print({heavy} & set(sys.modules))")
    assert done.stdout.strip() == "set()"


def test_every_rank_has_the_answer():
    code = (
        "import bristle; from mpi4py import MPI;"
        "t = bristle.sweep(models=['beam', 'solid'], kn_N_m=[1e5, 2e6], height_m=0.05,"
        "  cells=(1, 1, 12), length_m=0.05);"
        "r = bristle.drop(model='solid', cells=(1, 1, 12), length_m=0.05);"
        "w = MPI.COMM_WORLD; all = w.gather((w.rank, [*t['rebound_ratio'], r.rebound_ratio]));"
        "w.rank == 0 and print(json.dumps(all))"
    )
    done = mpirun(2, "-c", f"import json; {code}", timeout_s=300.0)
    said = json.loads(done.stdout)
    assert [rank for rank, _ in said] == [0, 1]
    assert said[0][1] == said[1][1]
