"""The documents: they build without a warning, their links lead somewhere, their Python runs."""

from __future__ import annotations

import re

import pytest
import readme
from commands import python
from made_drops import QUICK, write_drops

from bristle.solver.effects.library import EFFECTS
from bristle.studies.inputs.fields import DROP_FLAGS, LIST_FLAGS
from bristle.studies.inputs.study_fields import LOOP_FLAGS, OWN_FLAGS
from bristle.studies.loop.kinds.drops import problem as drops_module

pytestmark = pytest.mark.serial


def test_they_build_without_a_warning(tmp_path):
    built = tmp_path / "site"
    done = python(
        "-m", "sphinx", "-W", "-q", "-d", tmp_path / "tree", readme.REPOSITORY / "docs", built
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    pages = {path.stem for path in (readme.REPOSITORY / "docs").glob("*.md")}
    assert pages <= {path.stem for path in built.glob("*.html")}
    inputs = (built / "inputs.html").read_text()
    for flag in (*DROP_FLAGS, *LIST_FLAGS, *OWN_FLAGS, *LOOP_FLAGS):
        assert f">{flag.option}</span>" in inputs
        assert f">{flag.field}</span>" in inputs
    assert "bristle.studies.api.close_loop" in (built / "python.html").read_text()


@pytest.mark.parametrize("page", readme.PAGES, ids=lambda page: page.stem)
def test_links_lead_to_files(page):
    for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / link).exists(), link


def test_readme_is_two_pages():
    assert len(readme.PAGES[0].read_text(encoding="utf-8").splitlines()) <= 250


def test_their_python_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(drops_module, "carried", lambda kind, quantities: list(QUICK))
    write_drops(tmp_path / "my-drops", [EFFECTS["wear"](decades=2.0)], "worn")
    block, further = readme.blocks("python")
    names: dict = {}
    exec(block.replace('"my-drops")', '"my-drops", no_3d=True)'), names)
    exec(further, {})
    ratio, loss_J = re.findall(r"# ([\d.]+), ([\d.]+) J", block)[0]
    assert readme.agree(ratio, names["r"].rebound_ratio)
    assert readme.agree(loss_J, names["r"].energy.material_loss_J)
    assert len(names["t"]) == 20
    assert names["v"].effects == ["wear"]
