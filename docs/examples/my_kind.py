"""A kind of data of one's own: how long a bristle's tip touches a metal plate.

    bristle close-loop --plugin my_kind.py my-closures

The bristle closes an electric circuit. A dataset of kind ``closures`` has a table of ``drop, y0_mm,
closed_us`` and, in ``[measurement]``, the clock's ``sigma_t_s``. Contact time shows what heights do
not: stiffness apart from losses.
"""

from pathlib import Path

import numpy as np

from bristle.studies.data.datasets import read_manifest
from bristle.studies.data.tables import column, read_table
from bristle.studies.inputs.kinds import Kind
from bristle.studies.loop.kinds.drops.problem import damping, emulator_for, stiffness
from bristle.studies.loop.problem import Problem
from bristle.studies.loop.responses.drop_model import DropModel, Drops, Errors

TIME = 1  # of `table.QUANTITIES`
EFFECTS = ("contact_damping", "stiffening_contact", "plastic_contact", "adhesion", "wear")


def closures(folder: Path) -> Problem:
    """The problem of such a dataset."""
    manifest = read_manifest(folder, "closures")
    path = manifest.table()
    rows = read_table(path, required=("drop", "y0_mm", "closed_us"))
    drop = column(path, rows, "drop", whole=True)
    y0_m = 1e-3 * column(path, rows, "y0_mm", above=0.0)
    closed_s = 1e-6 * column(path, rows, "closed_us", above=0.0)
    sigma_s = manifest.measurement.get("sigma_t_s", 1e-6)
    emulator = emulator_for(y0_m, manifest)
    drops = Drops(emulator, y0_m, drop - drop[0], (TIME,))
    errors = Errors.independent(np.array([sigma_s]), np.ones((len(drops), 1), dtype=bool))
    kn, beta = stiffness(manifest.kn_N_m, emulator), damping(manifest)

    def model(effects: tuple[str, ...]) -> DropModel:
        return DropModel(drops, kn, effects, errors, beta=beta)

    return Problem(
        values=closed_s / sigma_s,
        scale=np.full(len(drops), 1e6 * sigma_s),
        unit="µs",
        quantity=np.full(len(drops), "contact time (µs)"),
        group=drop.astype(np.int64),
        covariates={"height": y0_m, "order": drops.order},
        baseline=model(()),
        candidates=[model((name,)) for name in EFFECTS],
        combine=model,
        confirm_why="contact times are not confirmed by the solid",
        sigma_declared="sigma_t_s" in manifest.measurement,
    )


KIND = Kind("closures", closures)
