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
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import BeforeValidator

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
from .inputs.fields import Plugins
from .inputs.flags import Fields
from .inputs.named import EffectInput, read_effects
from .inputs.sources import checked
from .loop.responses.table_drops import drops_of, its_s, read_off
from .running.files import cannot_write, prepare_folder, to_json, together, write_atomically
from .running.mark import FOREIGN, write_whole

COLUMNS = ("drop", "y0_mm", "y1_mm", "contact_time_ms", "peak_force_N")
# Releases by hand: the height is known as measured, not as meant.
RELEASE_STD_M = 5e-4
# Of the unlisted ripple; no multiple of the heights' spacing, which would hide it.
RIPPLE_M = 0.032
TABLE_FILE, MANIFEST_FILE, TRUTH = "drops.csv", "dataset.toml", "bristle-truth-1"
# All that lies in a made dataset's folder.
FILES = (TABLE_FILE, MANIFEST_FILE)
# Steps of the generator, finer than the loop's.
FINER = 0.5


class Noise(StrEnum):
    """How errors of measurement are distributed, at the declared standard deviation.

    Heavy-tailed ones are Student's of three degrees of freedom, one in twenty is five times as
    large among outliers, and those of neighbouring drops correlate by a half.
    """

    GAUSSIAN = "gaussian"
    HEAVY = "heavy-tailed"
    OUTLIERS = "outliers"
    CORRELATED = "autocorrelated"


class Strange(StrEnum):
    """Effects that no list has: of them the loop can only say that something is missing."""

    SHIFT = "session-shift"
    RIPPLE = "height-ripple"
    ALTERNATION = "alternation"


def read_unlisted(value: Any) -> Any:
    """An unlisted effect and its strength, also as ``NAME=STRENGTH``."""
    if not isinstance(value, str):
        return value
    name, _, strength = value.partition("=")
    try:
        found = Strange(name), float(strength)
    except ValueError:
        found = None
    if found is None or not abs(found[1]) < 1.0:
        raise ValueError(
            f"must be NAME=STRENGTH, NAME one of {', '.join(Strange)}, STRENGTH between -1 and 1, "
            f"not '{value}'"
        )
    return found


class Recipe(Fields):
    """What a made dataset holds; an ``unlisted`` effect has a relative strength on the height
    after."""

    plugins: Plugins = ()
    effects: Annotated[tuple[EffectInput, ...], BeforeValidator(read_effects)] = ()
    unlisted: Annotated[tuple[Strange, float] | None, BeforeValidator(read_unlisted)] = None
    n_drops: int = 48
    heights_m: tuple[float, ...] = paper.HEIGHTS_M
    kn_N_m: float = paper.KN_CHOSEN_N_M
    sigma_y_m: float = 3e-4
    sigma_t_s: float = 2e-6
    sigma_force_N: float = 0.5
    noise: Noise = Noise.GAUSSIAN
    sensors: bool = True
    friction: float = paper.FRICTION
    seed: int = 0


def reduced_body() -> ModalBody:
    """The paper's bristle as a reduced solid that may lean; collective."""
    from mpi4py import MPI

    from .loop.kinds.drops.solid import reduced_solid

    return reduced_solid(Bristle(), paper.GRAVITY_M_S2, True, MPI.COMM_WORLD)


@dataclass(frozen=True)
class Made:
    """A dataset and its truth: ``measured`` and ``true`` (drops, 4) are y0, y1, contact time and
    peak force as read, and as an instrument without noise would read them."""

    recipe: Recipe
    measured: Array
    true: Array


def make(recipe: Recipe, body: ModalBody) -> Made:
    """Drop, disturb, measure. The same recipe gives the same numbers."""
    chance, errors = (np.random.default_rng([recipe.seed, stream]) for stream in (1, 2))
    effects = [each.effect() for each in recipe.effects]
    cycle = -(-recipe.n_drops // len(recipe.heights_m))
    meant = chance.permutation(np.repeat(recipe.heights_m, cycle)[: recipe.n_drops])
    heights = np.maximum(meant + RELEASE_STD_M * chance.normal(size=recipe.n_drops), 1e-3)
    scenes = [
        enter_all(
            Scene(
                height_m=float(height),
                order=i,
                chance=tuple(map(float, chance.normal(size=2))),
                beta_s=body.beta_s,
                law=Linear(recipe.kn_N_m),
            ),
            effects,
        )
        for i, height in enumerate(heights)
    ]
    true = _seen(scenes, recipe, body)
    if recipe.unlisted is not None:
        strange, strength = recipe.unlisted
        true[:, 1] *= 1.0 + strength * pattern(strange, heights)
    sigma = np.array([recipe.sigma_y_m, recipe.sigma_y_m, recipe.sigma_t_s, recipe.sigma_force_N])
    measured = true + sigma * _errors(recipe.noise, (len(true), 4), errors)
    measured[:, :2] = np.maximum(measured[:, :2], [1e-4, 0.0])
    return Made(recipe, measured, true)


def _seen(scenes: Sequence[Scene], recipe: Recipe, body: ModalBody) -> Array:
    """What a perfect reading of the instruments gives of these drops (drops, 4)."""
    g, bristle = paper.GRAVITY_M_S2, Bristle(material=Material(beta_s=body.beta_s))
    columns = [(s.height_m, s.release_speed_m_s, s.drag_kg_m / body.mass_kg) for s in scenes]
    heights, speeds, drag = np.array(columns).T
    falls = [
        replace(scene, height_m=float(height))
        for scene, height in zip(scenes, fallen(heights, g, speeds, drag), strict=True)
    ]
    steps = np.array([FINER * its_s(bristle, scene.law.kn_N_m) for scene in falls])
    found = np.empty((len(scenes), 3))
    for step in np.unique(steps):
        mine = np.flatnonzero(steps == step)
        found[mine] = drops_of(body, [falls[i] for i in mine], g, float(step), recipe.friction)
    before = [scene.y_scale * (scene.height_m + scene.y_offset_m) for scene in scenes]
    return np.column_stack([before, read_off(found, scenes, body.mass_kg)])


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


def table_of(made: Made) -> str:
    """The dataset's table as CSV, in the units of CONTRACT.md."""
    table = pd.DataFrame(made.measured * [1e3, 1e3, 1e3, 1.0], columns=COLUMNS[1:])
    table.insert(0, COLUMNS[0], 1 + np.arange(len(table)))
    columns = COLUMNS if made.recipe.sensors else COLUMNS[:3]
    return table.to_csv(columns=columns, index=False, float_format="%.6g")


def manifest_of(recipe: Recipe) -> str:
    """The dataset's dataset.toml, which declares the instruments and no effect."""
    sensors = ""
    if recipe.sensors:
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


def prepare_dataset(folder: Path, truth: Path) -> None:
    """Make ``folder``, and see that a dataset and its truth can be written.

    Raises InputError where the truth would lie in the dataset's folder, or something that is not
    the program's would be replaced.
    """
    if folder.resolve() in (truth.resolve(), *truth.resolve().parents):
        raise InputError(
            f"--truth {truth}: lies in the dataset's own folder, where it would be seen"
        )
    prepare_folder(folder, *FILES)
    if (
        truth.is_dir()
        or not next(each for each in truth.absolute().parents if each.exists()).is_dir()
    ):
        raise InputError(f"--truth {truth}: there can be no such file")
    if os.path.lexists(truth) and not _is_truth(truth):
        raise InputError(f"--truth {truth}: {FOREIGN}; move it away, or choose another --truth")


def _is_truth(path: Path) -> bool:
    """Whether a file says of itself that it is the truth of a dataset, since no mark lies beside
    it: its folder may be one of many users."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return path.is_file() and not path.is_symlink() and found["schema"] == TRUTH
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


def write_dataset(made: Made, folder: Path, truth: Path) -> None:
    """Write the dataset into ``folder``, its truth to the file ``truth`` outside it.

    Raises InputError as `prepare_dataset` does.
    """
    prepare_dataset(folder, truth)
    with together(folder, MANIFEST_FILE):
        write_atomically(folder / TABLE_FILE, table_of(made))
        write_atomically(folder / MANIFEST_FILE, manifest_of(made.recipe))
        try:
            write_whole(truth, to_json(truth_of(made)) + "\n")
        except OSError as error:
            raise cannot_write(truth, error) from error


def recipe_of(
    effects: Sequence[str], unlisted: str | None, plugins: Sequence[str] = (), **values: Any
) -> Recipe:
    """The recipe of a command line. Raises InputError naming the option."""
    values |= {"plugins": plugins, "effects": effects, "unlisted": unlisted}
    return checked(Recipe, values, {name: f"--{name}" for name in ("noise", "unlisted")})


def run_synth(recipe: Recipe, out: Path, truth: Path) -> None:
    """Make the dataset of ``recipe``; collective. Raises InputError, ComputationError."""
    from mpi4py import MPI

    from ..meshes.collective import run_on_one_rank

    run_on_one_rank(MPI.COMM_WORLD, lambda: prepare_dataset(out, truth))
    body = reduced_body()
    run_on_one_rank(MPI.COMM_WORLD, lambda: write_dataset(make(recipe, body), out, truth))


if __name__ == "__main__":
    as_script("synth")
