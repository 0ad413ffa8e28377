"""The Python interface: the command's answers by name, in one process and in several."""

from __future__ import annotations

import inspect
import json
import linecache
import math
import pickle
import re
import warnings
from dataclasses import dataclass, replace

import derived
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from commands import mpirun, python
from made_drops import QUICK, write_drops
from matplotlib.axes import Axes

import bristle
from bristle.solver import paper
from bristle.solver.effects.base import Effect, Parameter, Place
from bristle.solver.effects.library import EFFECTS
from bristle.solver.errors import ComputationError
from bristle.studies.api import SIGNATURES
from bristle.studies.api.signatures import in_python
from bristle.studies.cli import main
from bristle.studies.loop.kinds.drops import problem as drops_module
from bristle.studies.running.cases import CaseSession
from bristle.studies.running.mark import MARK

pytestmark = [pytest.mark.serial, pytest.mark.usefixtures("no_pictures")]

LEANING = {"model": "solid", "tilt_deg": 2, "friction": 0, "cells": (1, 2, 24), "length_m": 0.05}
# What differs from run to run, and what a folder alone has.
OWN = {"wall_s", "peak_rss_MB", "mark"}


def test_a_drop_is_that_of_the_command(tmp_path):
    found = bristle.drop(**LEANING)
    options = "--model solid --tilt 2 --friction 0 --cells 1 2 24 --length 0.05 --no-fields"
    assert main(["drop", *options.split(), "--out", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "result.json").read_text())
    written["inputs"]["write_fields"] = True
    said = json.loads(json.dumps(found.to_dict()))
    assert written.keys() - OWN <= said.keys()
    assert all(written[name] == said[name] for name in written.keys() - OWN)
    assert found.rebound_ratio == found["rebound_ratio"]
    assert found.inputs.tilt_deg == 2.0
    assert found.energy.kinetic_J == found["energy"]["kinetic_J"] > 0.0
    pd.testing.assert_frame_equal(found.history, pd.read_csv(tmp_path / "history.csv"))
    assert "rebound ratio y1/y0" in repr(found)
    assert "rebound_ratio" in dir(found)


def test_a_drop_with_a_folder_leaves_the_commands_files(tmp_path):
    arrays = {"kn_N_m": np.float64(1e5), "cells": np.array([1, 2, 3])}
    found = bristle.drop(model="beam", out=tmp_path, **arrays)
    assert found.inputs.cells == [1, 2, 3]
    assert found.to_dict() == json.loads((tmp_path / "result.json").read_text())
    again = pickle.loads(pickle.dumps(found))
    assert again.rebound_ratio == found.rebound_ratio
    pd.testing.assert_frame_equal(again.history, found.history)


def test_a_name_that_is_none_is_refused():
    with pytest.raises(AttributeError, match="rebound_ratio"):
        _ = bristle.drop(model="analytic").rebound
    with pytest.raises(AttributeError, match="no attribute 'drops'"):
        bristle.drops()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: bristle.drop(kn_N_m=-1.0), "kn_N_m: must be greater"),
        (lambda: bristle.drop(knn=1.0), "knn: is no known input"),
        (lambda: bristle.drop(tilt=2.0), "tilt: .*; did you mean tilt_deg"),
        (
            lambda: bristle.sweep(height_m=0.05, heights_m=0.05),
            "height_m: given twice, also as heights_m",
        ),
        (lambda: bristle.drop(model="beam", out=""), "out: must be a folder"),
        (lambda: bristle.its(models=[]), "models: is an empty list"),
        (lambda: bristle.sweep(models="beam", height_m=[]), "height_m: is an empty list"),
        (lambda: bristle.view(None), "result: must be a folder"),
        (lambda: bristle.drop(out="a\0b"), "out: must be a folder"),
        (lambda: bristle.calibrate("a\0b"), "dataset: must be a folder"),
        (lambda: bristle.drop(until=10**400), "until: must be impact"),
        (lambda: bristle.drop(comm=3), "comm: must be a communicator"),
        (lambda: bristle.synth(truth=3), "truth: must be a file"),
        (lambda: EFFECTS["wear"]("a"), "wear: decades must be a number"),
        (lambda: bristle.track("x.mp4", diameter_mm=3.0), "diameter_mm: is for body ball"),
        (lambda: bristle.drop(out="/proc/none"), "out /proc/none: cannot be written"),
    ],
)
def test_wrong_inputs_are_named_as_they_were_given(call, words):
    with pytest.raises(bristle.InputError, match=f"^{words}"):
        call()


def test_errors_of_computing_name_inputs_as_well(monkeypatch):
    def fail(self, inputs, *others):
        raise ComputationError("it is too stiff; lower --kn or --its", inputs=("until",))

    monkeypatch.setattr(CaseSession, "run", fail)
    with pytest.raises(bristle.ComputationError) as raised:
        bristle.drop(model="analytic")
    assert str(raised.value) == "it is too stiff; lower kn_N_m or its_s (until)"


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


def test_warnings_come_at_the_line_of_the_call_and_nothing_is_printed(capsys, tmp_path):
    coarse = {"its_s": 1e-4, "until": "impact"}
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        found = bristle.drop(model="beam", **coarse)
        written = bristle.drop(model="beam", **coarse, out=tmp_path)
    said = [in_python(each) for each in found.warnings + written.warnings]
    assert [str(each.message) for each in seen] == said != []
    assert {each.category for each in seen} == {bristle.BristleWarning}
    assert {each.filename for each in seen} == {__file__}
    assert "bristle.drop" in linecache.getline(__file__, seen[0].lineno)
    assert capsys.readouterr() == ("", "")


def test_a_sweep_that_writes_nothing_warns_as_one_that_does(tmp_path):
    asked = {"models": "beam", "kn_N_m": [1e6, 2e6], "height_m": 0.05, "deflection": "small"}
    with pytest.warns(bristle.BristleWarning, match=r"leans by 20 degrees.*\(2 of 4 cases\)"):
        table = bristle.sweep(**asked, tilt_deg=[0, 20])
    assert list(table.attrs["warnings"].values()) == [2]
    with pytest.warns(bristle.BristleWarning, match="2 of 4 cases have warnings"):
        bristle.sweep(**asked, tilt_deg=[0, 20], out=tmp_path)


def test_every_input_of_a_command_is_a_parameter_with_its_meaning():
    for name, asked in SIGNATURES.items():
        function, method = getattr(bristle, name), getattr(bristle.Session, name)
        parameters = inspect.signature(function).parameters
        text = inspect.getdoc(function)
        assert {flag.field for flag in asked.flags} <= set(parameters)
        for flag in asked.flags:
            default = parameters[flag.field].default
            assert asked.model.model_fields[flag.field].default in (default, flag.default)
            assert re.search(rf"^{flag.field} : .+\n    \S", text, re.MULTILINE), flag.field
        assert "--" not in re.sub(r"(?m)^-+$", "", text), name
        assert set(inspect.signature(method).parameters) - {"self"} == set(parameters) - {"comm"}
    assert "kn_N_m : float, in N/m" in inspect.getdoc(bristle.drop)
    assert "height_m: float = 0.05" in str(inspect.signature(bristle.drop))


def test_what_is_derived_from_the_declared_inputs_is_up_to_date():
    """Otherwise: docker/run python3 tests/derived.py."""
    assert derived.STUB.read_text() == derived.stub()
    page = derived.INPUTS.read_text()
    assert derived.with_tables(page) == page


def test_infinity_and_the_history_are_what_they_are():
    found = bristle.drop(model="beam", kn_N_m=math.inf, contact="augmented", until="impact")
    assert found.inputs.kn_N_m == math.inf
    assert found.to_dict()["inputs"]["kn_N_m"] == "inf"
    assert found["history"] is found.history
    assert set(bristle.Energy.__annotations__) == set(found.energy)
    assert set(found) <= set(bristle.Drop.__annotations__)
    with pytest.raises(KeyError):
        _ = found["nothing"]


@dataclass(frozen=True)
class Softer(Effect):
    """As a user writes it in a cell of a notebook."""

    name = "softer"
    title = "Less damping in the material"
    place = Place.BODY
    kinds = frozenset()
    source = "a test"
    parameters = (Parameter("share", "", 0.1, 2.0, 0.5, 1.0),)
    share: float = 1.0

    def enter(self, scene):
        return replace(scene, beta_s=scene.beta_s * self.share)


def test_an_effect_may_be_an_instance_of_a_class_from_anywhere():
    expected = bristle.drop(model="beam", beta_s=0.5 * paper.BETA_S).rebound_ratio
    again = type("Softer", (Softer,), {})
    for kind in (Softer, Softer, again):  # the cell is run again
        found = bristle.drop(model="beam", effects=[kind(share=0.5)])
        assert found.rebound_ratio == expected
        assert found.inputs.effects == [{"name": "softer", "parameters": {"share": 0.5}}]
    with pytest.raises(bristle.InputError, match="unknown effect 'softer'"):
        bristle.drop(model="beam", effects=["softer:share=0.5"])
    own = EFFECTS["contact_damping"](c_N_s_m=5.0)
    by_name = bristle.drop(model="beam", effects=["contact_damping:c_N_s_m=5"])
    assert bristle.drop(model="beam", effects=[own]).rebound_ratio == by_name.rebound_ratio
    with pytest.raises(bristle.InputError, match=r"^effects: must be NAME:param=value"):
        bristle.drop(model="beam", effects=[3.0])


def test_steps_scatter_and_calibration_are_those_of_the_commands(tmp_path):
    steps = bristle.its(models="beam", kn_N_m=[1e5, 2e6], its_s=[1e-5, 3e-6, 1e-6], out=tmp_path)
    assert len(steps.table) == 6
    pd.testing.assert_frame_equal(steps.needs, pd.read_csv(tmp_path / "needs.csv"))
    assert "rebound_ratio" in repr(steps)
    asked = {"model": "beam", "drops": 40, "seed": 3, "elements": 8}
    drops = bristle.scatter(**asked)
    assert len(drops.table) == drops.n_drops == 40
    assert drops.table.rebound_ratio.mean() == pytest.approx(drops.statistics.mean.estimate)
    found = bristle.calibrate("paper", level=0.95)
    assert found.kn_N_m.low < found.kn_N_m.estimate < found.kn_N_m.high
    per_face, at_node = found.programs.value_si.iloc[:2]
    assert at_node == pytest.approx(found.kn_N_m.estimate)
    assert per_face == pytest.approx(found.kn_per_area_N_m3)
    for record in (steps, drops, found):
        assert record._repr_html_().startswith("<table>")
        assert isinstance(record.plot(), Axes)
        assert pickle.loads(pickle.dumps(record)) == record


def test_a_made_dataset_and_a_mesh(tmp_path):
    made = bristle.synth(effects=["wear:decades=1"], drops=12, seed=3, out=tmp_path / "data")
    assert made.effects[0].parameters.decades == 1.0
    pd.testing.assert_frame_equal(made.table, pd.read_csv(tmp_path / "data" / "drops.csv"))
    assert json.loads((tmp_path / "data-truth.json").read_text())["seed"] == 3
    mesh = bristle.mesh(cells=(1, 2, 20))
    assert mesh.grid.n_cells == mesh.quality.n_cells == 40
    assert mesh.grid.volume == pytest.approx(mesh.quality.volume_m3, rel=1e-5)
    assert all(isinstance(each.plot(), Axes) for each in (made, mesh))
    with pytest.raises(bristle.InputError, match=r"^friction: is no input of mesh"):
        bristle.mesh(friction=0.1)


def test_no_films_to_track_are_refused():
    with pytest.raises(bristle.InputError, match="^no film is given$"):
        bristle.track([])


def test_a_plot_shows_what_the_history_holds():
    found = bristle.drop(model="beam")
    figure, ax = plt.subplots()
    assert found.plot(ax) is ax
    line = ax.lines[0].get_ydata()
    assert max(line) == pytest.approx(1e3 * found.history.tip_y_m.max())
    (force,) = ax.child_axes[0].lines
    assert max(force.get_ydata()) == pytest.approx(found.peak_force_N, rel=1e-9)
    plt.close(figure)


def test_pictures_of_a_result(tmp_path):
    bristle.drop(model="beam", out=tmp_path)
    written = bristle.view(tmp_path)
    assert {path.name for path in written} == {"history.svg", "history.png"}
    assert all(path.exists() for path in written)


def test_to_import_it_loads_nothing_that_computes():
    heavy = {"numpy", "numba", "mpi4py", "pydantic", "pandas"}
    done = python("-c", f"import sys, bristle; print({heavy} & set(sys.modules))")
    assert done.stdout.strip() == "set()"


RANKS = """
import bristle, json
from mpi4py import MPI

world, small = MPI.COMM_WORLD, dict(cells=(1, 1, 12), length_m=0.05)
table = bristle.sweep(models=["beam", "solid"], kn_N_m=[1e5, 2e6], height_m=0.05, **small)
steps = bristle.its(models="beam", kn_N_m=1e6, its_s=[1e-5, 3e-6])
said = (
    *table["rebound_ratio"],
    bristle.drop(model="solid", **small).rebound_ratio,
    *map(float, steps.needs.its_needed_s),
    bristle.synth(drops=6).table.sum().tolist(),
    bristle.calibrate("paper").kn_N_m.estimate,
    bristle.scatter(model="beam", drops=20, elements=8).n_drops,
    bristle.mesh(cells=(1, 1, 10)).grid.n_cells,
)
kn = 1e6 * (1 + world.rank)
own = bristle.drop(model="solid", **small, kn_N_m=kn, until="impact", comm=MPI.COMM_SELF)
every = world.gather((said, own.ranks, own.peak_force_N))
world.rank == 0 and print(json.dumps(every))
"""


def test_every_rank_has_the_answer_of_all_and_may_work_alone():
    (said, *own), (other, *others) = json.loads(mpirun(2, "-c", RANKS, timeout_s=300.0).stdout)
    assert said == other
    assert own[0] == others[0] == 1
    assert own[1] < others[1]
