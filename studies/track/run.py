"""`bristle track`: films of drops into a dataset of tracks, with a page and overlay films.

Also a script: ``python3 -m bristle.studies.track FILM --out my-films``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from mpi4py import MPI

from ...meshes.collective import run_on_one_rank
from ...solver.errors import InputError
from ..inputs.study_fields import TrackInputs
from ..report.page import REPORT_FILES
from ..running.files import (
    folder_in_place,
    new_folders,
    prepare_folder,
    together,
    write_atomically,
    write_json,
)
from .films import TABLE, TrackedFilms, summary, track_films

DOCUMENT, MANIFEST, OVERLAYS = "track.json", "dataset.toml", "overlays"
# All that lies in the dataset's folder.
FILES = (DOCUMENT, TABLE, MANIFEST, f"{OVERLAYS}/", *REPORT_FILES)


def run_track(
    films: Sequence[Path],
    out: Path | None,
    inputs: TrackInputs,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
) -> tuple[dict[str, Any], pd.DataFrame]:
    """Track ``films`` and write the dataset into ``out``, or nothing where that is None.

    Collective; rank 0 works. Returns what track.json holds, and the table. Raises InputError where
    a film cannot be read or shows no body that falls.
    """
    return run_on_one_rank(comm, lambda: _run([Path(film) for film in films], out, inputs))


def _run(
    films: Sequence[Path], out: Path | None, inputs: TrackInputs
) -> tuple[dict[str, Any], pd.DataFrame]:
    if not films:
        raise InputError("no film is given")
    if out is None:
        found = track_films(films, inputs)
        return summary(found), found.table
    if out.resolve() in [film.resolve() for film in films]:
        raise InputError(f"--out {out}: is the folder of pictures that is read")
    with new_folders(out):
        prepare_folder(out, *FILES)
        found = track_films(films, inputs)
        return _written(found, out), found.table


def _written(found: TrackedFilms, out: Path) -> dict[str, Any]:
    """Write the dataset; what track.json holds."""
    from .overlay import write_overlay
    from .page import manifest, write_tracks

    document = summary(found)
    with together(out, DOCUMENT):
        with folder_in_place(out / OVERLAYS) as made:
            pictures = [
                write_overlay(each.track, made / f"{each.number}-{each.track.film.path.stem}.mp4")
                for each in found.films
            ]
        write_tracks(found, document, pictures, out)
        write_atomically(out / TABLE, found.table.to_csv(index=False))
        write_atomically(out / MANIFEST, manifest(found))
        write_json(out / DOCUMENT, document)
    return document


def told(document: dict[str, Any]) -> list[tuple[str, str]]:
    """Names and values of what a terminal shows."""
    unit = document["unit"]
    rows = [("films", str(len(document["films"]))), ("drops", str(len(document["drops"])))]
    for film in document["films"]:
        gravity = film["gravity_m_s2"]
        if film["mm_per_px"] is not None:
            words = f"{film['mm_per_px']:.4g} mm a pixel, from {film['scale_from']}"
            if gravity is not None:
                words += f"; things fall with {gravity['estimate']:.3g} m/s2"
            rows.append((Path(film["film"]).name[:22], words))
    for drop in document["drops"][:12]:
        ratios = ", ".join(f"{each['estimate']:.3f}" for each in drop["restitution"])
        lean = drop["lean_before_deg"]
        words = f"from {drop[f'y0_{unit}']:.2f} {unit}, frames ± {drop[f'sigma_{unit}']:.2g} {unit}"
        words += f", speed kept at impacts {ratios}" if ratios else ", no impact seen"
        words += "" if lean is None else f", leans {round(lean, 1) + 0.0:.1f} degrees"
        rows.append((f"drop {drop['drop']}", words))
    if len(document["drops"]) > 12:
        rows.append(("", f"and {len(document['drops']) - 12} more, on the page"))
    return rows + [("doubt", each) for each in document["warnings"]]
