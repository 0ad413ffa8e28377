"""Sweeps over further inputs: each case is the drop of its values; the JSON repeats it."""

import csv
import itertools
import json
import re

import numpy as np
import pytest

import bristle
from bristle.studies.cli import main
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.sources import checked
from bristle.studies.running.cases import CaseSession
from bristle.studies.sweep import SweepInputs

pytestmark = [pytest.mark.serial, pytest.mark.usefixtures("no_pictures")]

OPTIONS = ["--models", "beam", "--kn", "2e6", "--heights", "0.05"]


def sweep(*options, out, fixed=OPTIONS):
    assert main(["sweep", *fixed, *options, "--out", str(out)]) == 0
    with (out / "table.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_rows_are_the_drops_of_their_values(tmp_path, capsys):
    rows = sweep("--tilt", "0,2", "--friction", "0,0.5", out=tmp_path)
    assert len(rows) == 4
    for row in rows:
        lean, friction = float(row["tilt_deg"]), float(row["friction"])
        alone = bristle.drop(model="beam", tilt_deg=lean, friction=friction)
        assert float(row["rebound_ratio"]) == alone["rebound_ratio"]
    said = capsys.readouterr().out
    assert len(re.findall(r"friction [\d.]+, tilt_deg [\d.]+: y1/y0", said)) == 4
    pictures = {path.name for path in tmp_path.glob("*.svg")}
    assert "heights-friction-0.5-tilt_deg-2.svg" in pictures
    assert len(pictures) == 4


def test_what_follows_from_a_value_follows_it_in_every_case(tmp_path):
    """Damping from the material, tangential stiffness from Poisson's ratio; again from the JSON."""
    inputs = SweepInputs(material="steel,nylon", tilt_deg=[0, 2], models=("beam",))
    own = {(case.material, case.youngs_Pa, case.beta_s, case.kt_ratio) for case in inputs.cases()}
    assert own == {
        (each.material, each.youngs_Pa, each.beta_s, each.kt_ratio)
        for each in (checked(DropInputs, {"material": name}) for name in ("steel", "nylon"))
    }
    lists = ["--material", "steel,nylon", "--poisson", "0.3,0.4", "--length", "0.1,0.3"]
    rows = sweep(*lists, out=tmp_path / "first")
    written = json.loads((tmp_path / "first" / "sweep.json").read_text())["inputs"]
    assert (written["poisson"], written["material"]) == ([0.3, 0.4], ["steel", "nylon"])
    assert written["kt_ratio"] is written["beta_s"] is None
    one = SweepInputs(material="nylon", length_m=[0.1, 0.3], beta_s=None)
    assert one.model_dump()["beta_s"] is None
    assert len({case.beta_s for case in one.cases()}) == 2
    config = str(tmp_path / "first" / "sweep.json")
    again = sweep("--config", config, out=tmp_path / "again", fixed=())
    for row in (*rows, *again):
        del row["wall_s"]
    assert again == rows


def test_choices_too_and_from_python(tmp_path):
    beam = {"models": "beam", "kn_N_m": 2e6, "height_m": 0.05}
    table = bristle.sweep(**beam, contact=["penalty", "nitsche"])
    assert list(table["contact"]) == ["penalty", "nitsche"]
    assert table["rebound_ratio"][0] == pytest.approx(table["rebound_ratio"][1], rel=1e-3)
    beam["models"] = ["beam"]
    table = bristle.sweep(**beam, elements=np.array([4, 8, 4]), tilt_deg=0)
    assert list(table["elements"]) == [4, 8]
    assert "tilt_deg" not in table
    table = bristle.sweep(**beam, elements=range(4, 6), friction=[0.5, 0.0, 0])
    assert list(table["elements"]) == [4, 5, 4, 5]
    assert list(table["friction"]) == [0.0, 0.0, 0.5, 0.5]


def test_what_a_model_has_no_use_for_makes_no_new_case(tmp_path, monkeypatch):
    """A beam has no order, so that two orders are one case, with a row for each."""
    computed, run = [], CaseSession.run

    def counted(self, inputs, *more):
        computed.append((inputs.model.value, inputs.order))
        return run(self, inputs, *more)

    monkeypatch.setattr(CaseSession, "run", counted)
    rows = sweep("--models", "beam,analytic", "--order", "1,2", "--elements", "4,8", out=tmp_path)
    assert len(rows) == 8
    assert len(computed) == 3  # beams of 4 and 8 elements, and a mass on a spring
    beams = [row for row in rows if row["model"] == "beam"]
    assert {(row["order"], row["elements"]) for row in beams} == set(itertools.product("12", "48"))
    for row in beams:
        twin = next(each for each in beams if each["elements"] == row["elements"])
        assert row["rebound_ratio"] == twin["rebound_ratio"]
    assert main(["sweep", *OPTIONS, "--order", "1,2", "--out", str(tmp_path), "--resume"]) == 2


def test_pictures_are_those_of_the_last_sweep_and_few(tmp_path):
    sweep("--tilt", "0,2", out=tmp_path)
    mine = tmp_path / "heights-mine.svg"
    mine.write_text("mine")
    assert len(list(tmp_path.glob("*.svg"))) == 3
    sweep("--friction", "0.5,0.5000001", out=tmp_path)
    assert len(list(tmp_path.glob("*.svg"))) == 3
    sweep("--alpha", ",".join(map(str, range(1, 30))), "--elements", "2", out=tmp_path)
    assert [path.name for path in tmp_path.glob("*.svg")] == [mine.name]


@pytest.mark.parametrize(
    ("text", "line"),
    [("tilt = 0\nits = [1e-5, 1e-2]", 2), ("\n\ntilt = [0, 2, 85]", 3), ("kn = [1e5, 1e13]", 1)],
)
def test_later_values_of_a_list_are_refused_by_the_line_of_the_file(text, line, tmp_path, capsys):
    path = tmp_path / "sweep.toml"
    path.write_text(f"{text}\n")
    arguments = ["--config", str(path), "--models", "beam", "--out", str(tmp_path / "out")]
    assert main(["sweep", *arguments]) == 2
    name = text.split("\n")[line - 1].split()[0]
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith(f"bristle: error: {path}:{line}: {name}: ")


@pytest.mark.parametrize(
    "value",
    [[[0, 1], 2], {"a": 1}, [True, 2], True, object()],
    ids=lambda value: type(value).__name__,
)
def test_values_that_are_no_numbers_are_refused_from_python(value):
    for name in ("tilt_deg", "elements"):
        with pytest.raises(bristle.InputError, match=f"^{name}: must be"):
            bristle.sweep(**{name: value})


def test_too_many_cases_are_refused():
    many = [1e-6 * i for i in range(400)]
    with pytest.raises(bristle.InputError, match="more than 100,000 cases"):
        checked(SweepInputs, {"friction": many, "beta_s": many})
