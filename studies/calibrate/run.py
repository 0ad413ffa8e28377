"""`bristle calibrate`: normal contact stiffness from measured drops or the paper's own figures.

`bristle calibrate DATASET` and `bristle calibrate paper`. A model of the bristle gives y1/y0 as a
falling function of Kn; the drops give y1/y0 with an interval; the function is inverted.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ...meshes.collective import run_on_one_rank
from .. import __version__
from ..data.datasets import read_drops
from ..inputs.study_fields import CalibrateInputs
from ..report.page import REPORT_FILES
from ..running.files import prepare_folder, together, write_json
from ..running.mark import refuse_foreign
from .calibration import PAPER, Calibration, RatioModel, Stiffness, calibrate

SCHEMA = "bristle-calibrate-1"
RESULT_FILE = "calibrate.json"
# All that a calibration writes.
FILES = (RESULT_FILE, *REPORT_FILES)


def summary(found: Calibration, version: str) -> dict[str, Any]:
    """``calibrate.json``: plain numbers, SI, None for what the data cannot bound."""
    ratio, bristle, kn = found.ratio, found.bristle, found.kn.estimate
    return {
        "schema": SCHEMA,
        "version": version,
        "source": found.source,
        "seed": found.seed,
        "n_drops": ratio.n,
        "method": ratio.method,
        "body": {
            "length_m": bristle.length_m,
            "section": {"shape": type(bristle.section).__name__, **vars(bristle.section)},
            **asdict(bristle.material),
        },
        "gravity_m_s2": found.gravity_m_s2,
        "rebound_ratio": asdict(ratio.mean),
        "rebound_ratio_bootstrap": asdict(ratio.bootstrap) if ratio.bootstrap else None,
        "rebound_ratio_population": asdict(ratio.population),
        "rebound_ratio_std": ratio.spread,
        "reachable_ratio": list(found.curve.reachable),
        "kn_N_m": asdict(found.kn),
        "kn_per_area_N_m3": None if kn is None else kn / bristle.section.area_m2,
        "kn_bootstrap_N_m": asdict(found.kn_bootstrap) if found.kn_bootstrap else None,
        "kn_population_N_m": asdict(found.population),
        "trend": None if ratio.trend is None else asdict(ratio.trend),
        "warnings": list(found.warnings),
        "curve": {
            "kn_N_m": found.curve.kn_N_m.tolist(),
            "rebound_ratio": found.curve.ratio.tolist(),
        },
    }


def run_calibrate(
    source: str | Path,
    out: Path | None,
    inputs: CalibrateInputs | None = None,
    *,
    model: RatioModel | None = None,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
) -> dict[str, Any]:
    """Calibrate and write ``calibrate.json``, ``report.html``, figures and tables into ``out``, or
    nothing where that is None.

    ``source`` is a dataset's folder, or "paper". Collective; rank 0 works. Returns the summary.
    Raises InputError where the dataset is wrong, ComputationError where no Kn can be told.
    """
    asked = inputs or CalibrateInputs()
    return run_on_one_rank(comm, lambda: _run(str(source), out, asked, model))


def _run(
    source: str, out: Path | None, inputs: CalibrateInputs, model: RatioModel | None
) -> dict[str, Any]:
    drops = None if source == PAPER else read_drops(Path(source)).complete
    if out is not None:
        refuse_foreign(out, *FILES)
    found = calibrate(drops, model, seed=inputs.seed, level=inputs.level)
    content = summary(found, __version__)
    if out is None:
        return content
    from .page import write_calibration

    prepare_folder(out, *FILES)
    with together(out, RESULT_FILE):
        write_calibration(found, out)
        return write_json(out / RESULT_FILE, content)


def told(content: dict[str, Any]) -> list[tuple[str, str]]:
    """Name and value of what a terminal shows of a summary."""
    ratio, kn = content["rebound_ratio"], Stiffness(**content["kn_N_m"])
    estimate = "none fits" if kn.estimate is None else f"{kn.estimate / 1e6:.3g} MN/m"
    lines = [
        ("drops", str(content["n_drops"])),
        ("y1/y0", f"{ratio['estimate']:.3f} ({ratio['low']:.3f} to {ratio['high']:.3f})"),
        ("Kn", f"{estimate} ({kn.words()})"),
    ]
    if kn.estimate is not None:
        per_area = content["kn_per_area_N_m3"]
        lines += [
            ("Kn over the end face", f"{per_area:.3g} N/m³ = {1e-9 * per_area:.3g} N/mm³"),
            ("Kn at one node", f"{kn.estimate:.3g} N/m = {1e-3 * kn.estimate:.3g} N/mm"),
            ("where to enter these", "on the page: Abaqus, Ansys, CalculiX, Code_Aster, COMSOL"),
        ]
    return lines + [("doubt", each) for each in content["warnings"]]
