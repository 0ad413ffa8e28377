"""`bristle synth`: measurements of a bristle with an effect that its dataset does not declare.

The drops are those of the reduced solid; what reads the dataset fits the beam. The truth goes into
a file elsewhere.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ..meshes.collective import run_on_one_rank, with_mpi
from ..solver import paper
from ..solver.arrays import Array
from ..solver.bodies.modal import ModalBody
from ..solver.bristle import Bristle, Material
from ..solver.contact.laws import Linear
from ..solver.effects.base import Scene
from ..solver.effects.library import enter_all
from ..solver.errors import InputError
from ..solver.fall import fallen
from . import __version__
from .command.script import as_script
from .inputs.choices import Noise, Strange
from .inputs.study_fields import Recipe
from .loop.responses.table_drops import its_s, outcomes_of, quantities, read_off
from .running.files import (
    cannot_write,
    folder_in_place,
    new_folders,
    prepare_folder,
    remove,
    to_json,
    together,
    write_atomically,
)
from .running.mark import FOREIGN, write_whole
from .running.parallel import all_ranks
from .running.progress import progress

if TYPE_CHECKING:
    from mpi4py import MPI

    from .film.render import Flown

COLUMNS = ("drop", "y0_mm", "y1_mm", "contact_time_ms", "peak_force_N")
# Releases by hand: the height is known as measured, not as meant.
RELEASE_STD_M = 5e-4
TURNING_RAD_S = 0.02
# Of the unlisted ripple; no multiple of the heights' spacing, which would hide it.
RIPPLE_M = 0.032
TABLE_FILE, MANIFEST_FILE, TRUTH = "drops.csv", "dataset.toml", "bristle-truth-1"
# All that lies in a made dataset's folder.
FILES = (TABLE_FILE, MANIFEST_FILE)
# The folder of films, where these are asked for.
FILMS = "films"
# Steps of the generator, finer than the loop's.
FINER = 0.5


def reduced_body(comm: MPI.Intracomm) -> ModalBody:
    """The paper's bristle as a reduced solid that may lean; collective."""
    from .loop.kinds.drops.solid import reduced_solid

    return reduced_solid(Bristle(), paper.GRAVITY_M_S2, True, comm)


@dataclass(frozen=True)
class Made:
    """A dataset and its truth: ``measured`` and ``true`` (drops, 4) are y0, y1, contact time and
    peak force as read, and as an instrument without noise would read them; ``scenes`` (drops,) are
    what the drops of a body of mass ``mass_kg`` are made of, ``spin_rad_s`` (drops,) how fast it
    turns after the impact."""

    recipe: Recipe
    measured: Array
    true: Array
    spin_rad_s: Array
    scenes: Sequence[Scene]
    mass_kg: float


def make(recipe: Recipe, body: ModalBody) -> Made:
    """Drop, disturb, measure. The same recipe gives the same numbers."""
    chance, errors = (np.random.default_rng([recipe.seed, stream]) for stream in (1, 2))
    effects = [each.effect() for each in recipe.effects]
    cycle = -(-recipe.drops // len(recipe.heights_m))
    meant = chance.permutation(np.repeat(recipe.heights_m, cycle)[: recipe.drops])
    heights = np.maximum(meant + RELEASE_STD_M * chance.normal(size=recipe.drops), 1e-3)
    scenes = [
        enter_all(
            Scene(
                height_m=float(height),
                order=i,
                session=float(2 * i >= recipe.drops),
                chance=tuple(map(float, chance.normal(size=2))),
                beta_s=body.beta_s,
                law=Linear(recipe.kn_N_m),
            ),
            effects,
        )
        for i, height in enumerate(heights)
    ]
    true, spin_rad_s = _seen(scenes, recipe, body)
    if recipe.unlisted is not None:
        strange, strength = recipe.unlisted
        true[:, 1] *= 1.0 + strength * pattern(strange, heights)
    sigma = np.array([recipe.sigma_y_m, recipe.sigma_y_m, recipe.sigma_t_s, recipe.sigma_force_N])
    measured = true + sigma * _errors(recipe.noise, (len(true), 4), errors)
    measured[:, :2] = np.maximum(measured[:, :2], [1e-4, 0.0])
    return Made(recipe, measured, true, spin_rad_s, scenes, body.mass_kg)


def _seen(scenes: Sequence[Scene], recipe: Recipe, body: ModalBody) -> tuple[Array, Array]:
    """What a perfect reading of the instruments gives of these drops (drops, 4), and how fast the
    bristle turns after the impact (drops,)."""
    g, bristle = paper.GRAVITY_M_S2, Bristle(material=Material(beta_s=body.beta_s))
    columns = [(s.height_m, s.release_speed_m_s, s.drag_kg_m / body.mass_kg) for s in scenes]
    heights, speeds, drag = np.array(columns).T
    falls = [
        replace(scene, height_m=float(height))
        for scene, height in zip(scenes, fallen(heights, g, speeds, drag), strict=True)
    ]
    steps = np.array([FINER * its_s(bristle, scene.law.kn_N_m) for scene in falls])
    found, spin = np.empty((len(scenes), 3)), np.empty(len(scenes))
    for step in np.unique(steps):
        mine = np.flatnonzero(steps == step)
        out = outcomes_of(body, [falls[i] for i in mine], g, float(step), recipe.friction)
        found[mine], spin[mine] = quantities(out), np.hypot(out.spin_x_rad_s, out.spin_y_rad_s)
    before = [scene.y_scale * (scene.height_m + scene.y_offset_m) for scene in scenes]
    return np.column_stack([before, read_off(found, scenes, body.mass_kg)]), spin


def pattern(strange: Strange, heights_m: Array) -> Array:
    """The relative change (drops,) that an unlisted effect of strength one makes."""
    order = np.arange(len(heights_m))
    if strange is Strange.SHIFT:
        return np.where(order < len(order) // 2, 0.0, 1.0)
    if strange is Strange.RIPPLE:
        return np.asarray(np.sin(2.0 * math.pi * heights_m / RIPPLE_M))
    return np.where(order % 2 == 0, 1.0, -1.0)


def _errors(noise: Noise, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Errors of unit standard deviation, drop after drop."""
    plain = rng.normal(size=shape)
    if noise is Noise.HEAVY:
        return rng.standard_t(3.0, size=shape) / math.sqrt(3.0)
    if noise is Noise.OUTLIERS:
        return plain * np.where(rng.random(shape) < 0.05, 5.0, 1.0)
    if noise is Noise.CORRELATED:
        for i in range(1, shape[0]):
            plain[i] = 0.5 * plain[i - 1] + math.sqrt(0.75) * plain[i]
    return plain


def frame_of(values: Array) -> pd.DataFrame:
    """The table of `Made` values (drops, 4), in a dataset's units."""
    table = pd.DataFrame(values * [1e3, 1e3, 1e3, 1.0], columns=COLUMNS[1:])
    table.insert(0, COLUMNS[0], 1 + np.arange(len(table)))
    return table


def table_of(made: Made) -> str:
    """The dataset's table as CSV."""
    columns = COLUMNS[:3] if made.recipe.heights_only else COLUMNS
    return frame_of(made.measured).to_csv(columns=columns, index=False, float_format="%.6g")


def manifest_of(recipe: Recipe) -> str:
    """The dataset's dataset.toml, which declares the instruments and no effect."""
    sensors = ""
    if not recipe.heights_only:
        sensors = f"sigma_t_s = {recipe.sigma_t_s:g}\nsigma_force_N = {recipe.sigma_force_N:g}\n"
    return f"""\
[dataset]
title = "Made drops of a bristle"
kind = "drops"
source = "bristle synth {__version__}"
licence = "CC0-1.0"

[measurement]
file = "{TABLE_FILE}"
sigma_y_mm = {1e3 * recipe.sigma_y_m:g}
{sensors}gravity_m_s2 = {paper.GRAVITY_M_S2:g}
"""


def truth_of(made: Made) -> dict[str, Any]:
    """What is behind the dataset, and which table it belongs to."""
    recipe = made.recipe
    return {
        "schema": TRUTH,
        "version": __version__,
        "table_sha256": hashlib.sha256(table_of(made).encode()).hexdigest(),
        "effects": [effect.model_dump() for effect in recipe.effects],
        "unlisted": None if recipe.unlisted is None else str(recipe.unlisted[0]),
        "strength": 0.0 if recipe.unlisted is None else recipe.unlisted[1],
        "kn_N_m": recipe.kn_N_m,
        "noise": str(recipe.noise),
        "seed": recipe.seed,
        "without_noise": [[float(x) for x in row] for row in made.true],
        "columns": ["y0_m", "y1_m", "contact_time_s", "peak_force_N"],
    }


def prepare_dataset(folder: Path, truth: Path, *files: str) -> None:
    """Make ``folder``, and see that ``files`` and the truth can be written.

    Raises InputError where the truth would lie in the dataset's folder, or something that is not
    the program's would be replaced.
    """
    if folder.resolve() in (truth.resolve(), *truth.resolve().parents):
        raise InputError(
            f"--truth {truth}: lies in the dataset's own folder, where it would be seen"
        )
    prepare_folder(folder, *files)
    if (
        truth.is_dir()
        or not next(each for each in truth.absolute().parents if each.exists()).is_dir()
    ):
        raise InputError(f"--truth {truth}: there can be no such file")
    if os.path.lexists(truth) and not _is_truth(truth):
        raise InputError(f"--truth {truth}: {FOREIGN}; move it away, or choose another --truth")


def _is_truth(path: Path) -> bool:
    """Whether a file is the truth of a dataset as it was written. It says so itself, since no mark
    lies beside it: its folder may be one of many users."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        own = found.pop("sha256") == _sealed(found)["sha256"]
        return path.is_file() and not path.is_symlink() and found["schema"] == TRUTH and own
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


def _sealed(content: dict[str, Any]) -> dict[str, Any]:
    """The content with its own digest, by which it is known again."""
    return {**content, "sha256": hashlib.sha256(to_json(content).encode()).hexdigest()}


def flown(made: Made, k: int) -> Flown:
    """How the lower end of drop ``k`` moves, for a film of it. A bristle that turns with ω carries
    its end along, which so falls by L/2 ω² more slowly."""
    from .film.render import Flown, bouncing

    scene, spin = made.scenes[k], float(made.spin_rad_s[k])
    _, y1_m, contact_s, _ = made.true[k].tolist()
    height, until = bouncing(
        scene.height_m,
        y1_m / scene.y_scale - scene.y_offset_m,
        contact_s / scene.t_scale,
        paper.GRAVITY_M_S2,
        release_m_s=scene.release_speed_m_s,
        drag_1_m=scene.drag_kg_m / made.mass_kg,
        # one that turns lands on an edge next, and is not followed
        bounces=1 if spin > TURNING_RAD_S else 3,
        slower_m_s2=0.5 * paper.LENGTH_M * spin**2,
    )
    return Flown(height, until, scene.tilt_deg, math.degrees(spin))


def _write_films(made: Made, folder: Path) -> None:
    """Write a film of each drop into the folder `FILMS` in ``folder``, as a camera of 240 frames a
    second sees it. The bristle leans as it does in the drop, and goes on turning.

    Raises ComputationError where a film cannot be written.
    """
    from .film.render import Look, write_film

    count = len(made.scenes)
    with folder_in_place(folder / FILMS) as films, progress("films", count) as advance:
        for k in range(count):
            rng = np.random.default_rng([made.recipe.seed, 3, k])
            write_film(films / f"drop-{k + 1:03d}.mp4", flown(made, k), Look(), rng)
            advance()


def write_made(made: Made, folder: Path, truth: Path) -> dict[str, Any]:
    """Write the dataset, or its films, into ``folder``, the truth to the file ``truth`` outside it,
    and return that."""
    with together(folder, MANIFEST_FILE):
        if made.recipe.film:
            remove(*(folder / name for name in FILES))
            _write_films(made, folder)
        else:
            remove(folder / FILMS)
            write_atomically(folder / TABLE_FILE, table_of(made))
            write_atomically(folder / MANIFEST_FILE, manifest_of(made.recipe))
        content = _sealed(truth_of(made))
        try:
            write_whole(truth, to_json(content) + "\n")
        except OSError as error:
            raise cannot_write(truth, error) from error
        return content


def run_synth(
    recipe: Recipe, out: Path, truth: Path, comm: MPI.Intracomm | None = None
) -> dict[str, Any]:
    """Make the dataset of ``recipe``, or its films, in the folder ``out``; returns its truth, on
    every rank.

    Collective over ``comm``, all ranks of the job unless it is given. Raises InputError and
    ComputationError.
    """
    comm = with_mpi(comm or all_ranks())
    files = (f"{FILMS}/",) if recipe.film else FILES
    with new_folders(out):
        run_on_one_rank(comm, lambda: prepare_dataset(out, truth, *files))
        body = reduced_body(comm)
        return run_on_one_rank(comm, lambda: write_made(make(recipe, body), out, truth))


if __name__ == "__main__":
    as_script("synth")
