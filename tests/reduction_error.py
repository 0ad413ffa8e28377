"""The reduced solid against the full order at drops drawn at random: stated and true error.

    docker/run python3 tests/reduction_error.py --cases 24 --seed 1 --out results/reduction.csv

Bristle, damping, Kn, ITS and lean are drawn anew with each seed. Both take small strain, so that
they differ in their unknowns alone. The error is that of the motion after the first impact, in
units of its speed, a spin counting by its energy: what `reduction_error` estimates, down to
`RESOLVED`.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from mpi4py import MPI

from bristle.solver.drop import RESOLVED, DropResult
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.sources import checked
from bristle.studies.running.cases import run_case

STEEL = {"youngs_Pa": 207e9, "poisson": 0.28, "density_kg_m3": 7800.0}
POLYPROPYLENE = {"youngs_Pa": 1.5e9, "poisson": 0.42, "density_kg_m3": 910.0}
CELL_M = 2.5e-3


def drawn(chance: np.random.Generator) -> dict:
    """The inputs of one drop."""

    def decades(low: float, high: float) -> float:
        return float(f"{10.0 ** chance.uniform(np.log10(low), np.log10(high)):.3g}")

    length = decades(0.05, 0.35)
    material = STEEL if chance.random() < 0.7 else POLYPROPYLENE
    upright = chance.random() < 1.0 / 3.0
    return {
        **material,
        "length_m": length,
        "thickness_m": decades(4e-4, 1e-3),
        "width_m": decades(5e-4, 3e-3),
        "beta_s": decades(1e-8, 1.07e-5),
        "kn_N_m": decades(1e5, 1e8),
        "its_s": decades(1e-7, 1e-5),
        "height_m": decades(0.01, 0.05),
        "tilt_deg": 0.0 if upright else decades(0.3, 8.0),
        "friction": 0.0 if upright else float(chance.choice([0.0, 0.2, 0.5])),
        "contact": str(chance.choice(["penalty", "nitsche"])),
        "cells": (1, 2, max(8, round(length / CELL_M))),
        "deflection": "small",
        "until": "impact",
    }


def motion(found: DropResult, inputs: DropInputs) -> np.ndarray:
    """Velocity and spin (6,) after the impact, in m/s."""
    thick, wide, long = inputs.thickness_m, inputs.width_m, inputs.length_m
    squares = np.array([wide**2 + long**2, thick**2 + long**2, thick**2 + wide**2]) / 12.0
    spin = np.sqrt(squares) * np.array(found.spin_after_rad_s)
    return np.concatenate([found.velocity_after_m_s, spin])


def main() -> None:
    """Draw, run, and print a line a case."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=24)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    chance, rows = np.random.default_rng(arguments.seed), []
    for number in range(arguments.cases):
        values = drawn(chance)
        inputs = checked(DropInputs, {**values, "model": "reduced"})
        reduced = run_case(inputs, MPI.COMM_SELF)[0]
        full = run_case(checked(DropInputs, {**values, "model": "solid"}), MPI.COMM_SELF)[0]
        off = motion(reduced, inputs) - motion(full, inputs)
        true, stated = np.linalg.norm(off) / full.impact_speed_m_s, reduced.reduction_error
        rows.append({**values, "modes": reduced.n_dofs, "stated": stated, "true": true})
        print(
            f"{number:3d}  lean {values['tilt_deg']:4.2f}  Kn {values['kn_N_m']:8.2g}  "
            f"ITS {values['its_s']:8.2g}  beta {values['beta_s']:8.2g}  {values['contact']:8s} "
            f"vectors {reduced.n_dofs:4d}  stated {stated:.1e}  true {true:.1e}  "
            f"ratio {stated / max(true, RESOLVED):.2g}",
            flush=True,
        )
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    with arguments.out.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
