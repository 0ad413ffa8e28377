"""A small dataset of drops, made with the beam."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bristle.solver import paper
from bristle.solver.bristle import Bristle
from bristle.solver.contact.laws import Linear
from bristle.solver.effects.library import enter_all
from bristle.studies.loop.responses.emulator import Emulator
from bristle.studies.loop.responses.table_drops import beam_of, outcomes_of, quantities

# Effects that need no tables but the plain one, so that the test is quick on a new machine.
QUICK = ("height_offset", "release_velocity", "scale_error", "surface_phases", "wear")
COUNT = 40
SIGMA_MM = 0.3


SIGMA_S, SIGMA_N = 2e-6, 0.5


def write_drops(folder: Path, effects=(), title: str = "Made", *, forces: bool = False) -> Path:
    """A dataset of beam drops with ``effects`` in them, read with noise; with ``forces`` contact
    times and peak forces too."""
    rng = np.random.default_rng(11)
    emulator = Emulator(Bristle(), paper.GRAVITY_M_S2, 0.01, 0.05)
    heights = np.resize(np.array(paper.HEIGHTS_M), COUNT) * (1 + 0.02 * rng.standard_normal(COUNT))
    plain = replace(emulator.scene(), law=Linear(2e6))
    scenes = [
        enter_all(replace(plain, height_m=float(h), order=i), effects)
        for i, h in enumerate(heights)
    ]
    its = 1e-6 if forces else 5e-6
    beam = beam_of(emulator.bristle)
    found = quantities(outcomes_of(beam, scenes, emulator.gravity_m_s2, its, 0.5))
    top, times, peaks = found.T
    noise = SIGMA_MM * rng.standard_normal((COUNT, 2))
    rows = [
        f"{i + 1},{1e3 * y0 + a:.4f},{1e3 * y1 + b:.4f}\n"
        for i, (y0, y1, (a, b)) in enumerate(zip(heights, top, noise, strict=True))
    ]
    head, declared = "drop,y0_mm,y1_mm", f"sigma_y_mm = {SIGMA_MM}\n"
    if forces:
        head += ",contact_time_ms,peak_force_N"
        declared += f"sigma_t_s = {SIGMA_S}\nsigma_force_N = {SIGMA_N}\n"
        times = times + SIGMA_S * rng.standard_normal(COUNT)
        peaks = peaks + SIGMA_N * rng.standard_normal(COUNT)
        rows = [
            f"{row.rstrip()},{1e3 * time:.5f},{peak:.4f}\n"
            for row, time, peak in zip(rows, times, peaks, strict=True)
        ]
    folder.mkdir(exist_ok=True)
    (folder / "drops.csv").write_text("".join([head, "\n", *rows]))
    (folder / "dataset.toml").write_text(
        f"[dataset]\ntitle = '{title}'\nkind = 'drops'\n\n[measurement]\n{declared}"
    )
    return folder
