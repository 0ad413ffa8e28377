"""The package installs into a fresh environment on top of the distribution's dolfinx, and works."""

from __future__ import annotations

import os
import shutil
import subprocess
import venv
from pathlib import Path

import pytest
import readme

pytestmark = [pytest.mark.serial, pytest.mark.slow]
# What is left behind is what tests and editors make.
NOT_COPIED = shutil.ignore_patterns(
    ".git", "build", "results", "*.egg-info", "__pycache__", ".*_cache"
)


def test_its_dependencies_are_there_and_a_drop_and_a_loop_run(tmp_path):
    """Nothing is fetched: what is declared beyond the distribution's packages would be missing."""
    source = shutil.copytree(readme.REPOSITORY, tmp_path / "source", ignore=NOT_COPIED)
    place = tmp_path / "environment"
    venv.create(place, system_site_packages=True, with_pip=True)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}

    def run(*words: str | Path) -> str:
        done = subprocess.run(
            words, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=500
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    python, bristle = place / "bin" / "python", place / "bin" / "bristle"
    run(python, "-m", "pip", "install", "--no-index", "--no-build-isolation", source)
    assert "close-loop" in run(bristle, "--help")
    asked = "import bristle; print(bristle.__file__, bristle.drop(model='beam').rebound_ratio)"
    file, ratio = run(python, "-c", asked).split()
    assert Path(file).is_relative_to(place)
    assert float(ratio) == pytest.approx(0.6575, abs=1e-3)
    dataset = readme.REPOSITORY / "studies" / "measured" / "square-bar"
    assert "material_damping" in run(bristle, "close-loop", dataset, "--no-3d", "--out", "out")
    assert (tmp_path / "out" / "verdict.json").exists()
