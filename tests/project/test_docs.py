"""The documents: they build without a warning, their links lead somewhere, their Python runs."""

from __future__ import annotations

import html
import re
import shutil
from pathlib import Path

import pytest
import readme
from commands import python
from made_drops import QUICK, write_drops

from bristle.solver.effects.library import EFFECTS
from bristle.studies.inputs.sources import EVERY_FLAG
from bristle.studies.loop.kinds.drops import problem as drops_module

pytestmark = pytest.mark.serial


# What the lessons print, as a reader sees it: what each of them is there to show.
LESSONS = {
    "01_first_drop": (r"y1/y0 +0\.6575", r"numerical_J +-?0\.0000 µJ"),
    "02_kn_and_its": (r"Kn +2\.05 MN/m", r"Kn 2e\+06 N/m, rebound ratio +ITS up to 3\.2e-02 ms"),
    "03_leaning": (r"tip +y1/y0 = 0\.6748", r"leans by 2 degrees and is linear here"),
    "04_own_mesh": (r"notch 0\.8 mm +y1/y0 0\.\d+", r"were they in mm\?"),
    "05_verdict": (r"verdict +adequate", r"verdict +effect\n +effects +contact_damping"),
    "06_unknown": (r"verdict +unknown", r"by chance in \de-04|by chance in 0\.000\d"),
    "07_own_effect": (r"effects +my_effect", r"\n *-\d+\.\d  my_effect\n"),
    "08_inside_the_solid": (r"stiffness +0\.6399 MN/m", r"E A / L +0\.6398 MN/m"),
    "09_cluster": (r"24 cases in", r"ended with status 130", r"120 drops in the table"),
}


def build(tmp_path: Path, *options: str) -> Path:
    """The site, made from a copy of the documents, since lessons are made beside them."""
    source = shutil.copytree(
        readme.REPOSITORY / "docs", tmp_path / "docs", ignore=shutil.ignore_patterns("lessons")
    )
    built = tmp_path / "site"
    done = python("-m", "sphinx", "-W", "-q", *options, source, built, timeout_s=900.0)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    return built


def test_they_build_without_a_warning(tmp_path):
    built = build(tmp_path, "-D", "sphinx_gallery_conf.plot_gallery=0")
    pages = {path.stem for path in (readme.REPOSITORY / "docs").glob("*.md")}
    assert pages <= {path.stem for path in built.glob("*.html")}
    inputs = (built / "inputs.html").read_text()
    for flag in EVERY_FLAG:
        assert f">{flag.option}</span>" in inputs
        assert f">{flag.field}</span>" in inputs
    assert "bristle.studies.api.close_loop" in (built / "python.html").read_text()


@pytest.mark.campaign
@pytest.mark.timeout(1200)
def test_lessons_run_and_print_what_they_are_there_to_show(tmp_path):
    built = build(tmp_path)
    scripts = {path.stem for path in (readme.REPOSITORY / "docs" / "gallery").glob("*.py")}
    assert scripts == LESSONS.keys()
    for name, expected in LESSONS.items():
        page = (built / "lessons" / f"{name}.html").read_text()
        blocks = re.findall(r"sphx-glr-script-out.*?<pre>(.*?)</pre>", page, re.DOTALL)
        printed = html.unescape(re.sub(r"<[^>]+>", "", "\n".join(blocks)))
        for each in expected:
            assert re.search(each, printed), (name, each, printed)
        assert list((built / "_images").glob(f"sphx_glr_{name}_001.png")), name


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
    block, *further = readme.blocks("python")
    names: dict = {}
    exec(block.replace('"my-drops")', '"my-drops", no_3d=True)'), names)
    shared: dict = {}
    for each in further:
        exec(each, shared)
    assert shared["s"].x.array.size
    ratio, loss_J = re.findall(r"# ([\d.]+), ([\d.]+) J", block)[0]
    assert readme.agree(ratio, names["r"].rebound_ratio)
    assert readme.agree(loss_J, names["r"].energy.material_loss_J)
    assert len(names["t"]) == 20
    assert names["v"].effects == ["wear"]
