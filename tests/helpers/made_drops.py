"""A small dataset of drops, made with the beam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bristle.solver import paper
from bristle.solver.bristle import Bristle
from bristle.solver.contact.laws import Linear
from bristle.solver.effects.library import enter_all
from bristle.studies.loop.responses.response import Emulator
from bristle.studies.loop.responses.table_drops import beam_of, drops_of

# Effects that need no tables but the plain one, so that the test is quick on a new machine.
QUICK = ("height_offset", "release_velocity", "scale_error", "surface_phases", "wear")
COUNT = 40
SIGMA_MM = 0.3


def write_drops(folder: Path, effects=(), title: str = "Made") -> Path:
    """A dataset of beam drops with ``effects`` in them, read with noise."""
    rng = np.random.default_rng(11)
    emulator = Emulator(Bristle(), paper.GRAVITY_M_S2, 0.01, 0.05)
    heights = np.resize(np.array(paper.HEIGHTS_M), COUNT) * (1 + 0.02 * rng.standard_normal(COUNT))
    plain = replace(emulator.plain(), law=Linear(2e6))
    scenes = [
        enter_all(replace(plain, height_m=float(h), order=i), effects)
        for i, h in enumerate(heights)
    ]
    top = drops_of(beam_of(emulator.bristle), scenes, emulator.gravity_m_s2, 5e-6, 0.5)[:, 0]
    noise = SIGMA_MM * rng.standard_normal((COUNT, 2))
    rows = [
        f"{i + 1},{1e3 * y0 + a:.4f},{1e3 * y1 + b:.4f}\n"
        for i, (y0, y1, (a, b)) in enumerate(zip(heights, top, noise, strict=True))
    ]
    folder.mkdir(exist_ok=True)
    (folder / "drops.csv").write_text("drop,y0_mm,y1_mm\n" + "".join(rows))
    (folder / "dataset.toml").write_text(
        f"[dataset]\ntitle = '{title}'\nkind = 'drops'\n\n[measurement]\nsigma_y_mm = {SIGMA_MM}\n"
    )
    return folder
