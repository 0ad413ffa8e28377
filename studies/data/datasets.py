"""What does a dataset folder say, and is every value in it usable?

CONTRACT.md, "Datasets", gives the format. Reading is strict: a key that looks like a misspelt one,
a number that is none, a table that lies outside the folder each end with an InputError that names
file and line. What a dataset leaves out is the paper's bristle.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...solver import paper
from ...solver.bristle import Array, Bristle, Circle, Material, Rectangle, Section
from ...solver.errors import InputError
from .tables import check_order, column, inside, optional_column, read_table, read_text

KINDS = ("drops", "tracks", "forces", "waves", "falls")
PARTS = ("dataset", "body", "contact", "measurement")
BODY_KEYS = {
    "length_m": paper.LENGTH_M,
    "width_m": paper.WIDTH_M,
    "thickness_m": paper.THICKNESS_M,
    "diameter_m": None,
    "youngs_modulus_Pa": paper.YOUNGS_PA,
    "poisson_ratio": paper.POISSON,
    "density_kg_m3": paper.DENSITY_KG_M3,
    "damping_beta_s": paper.BETA_S,
    "damping_alpha_1_s": paper.ALPHA_1_S,
}
NUMBER_KEYS = ("sigma_y_mm", "sigma_t_s", "sigma_force_N", "fps", "gravity_m_s2")
WAVE_KEYS = ("signal", "gauge_x_m", "unit", "baseline_until_s", "first_pass_s", "predict_s")
MEASUREMENT_KEYS = ("file", *NUMBER_KEYS, *WAVE_KEYS)


@dataclass(frozen=True)
class Manifest:
    """A ``dataset.toml``: its folder, what it declares, and the body that this makes.

    ``kn_N_m`` is None where it is not declared, ``friction`` then the paper's; ``declared`` names
    the body's keys that are.
    """

    folder: Path
    title: str
    kind: str
    source: str
    licence: str
    bristle: Bristle
    declared: tuple[str, ...]
    kn_N_m: float | None
    measurement: Mapping[str, Any]
    friction: float = paper.FRICTION

    @property
    def gravity_m_s2(self) -> float:
        return float(self.measurement.get("gravity_m_s2", paper.GRAVITY_M_S2))

    def table(self) -> Path:
        """The measurement's table, which must lie in the folder."""
        return inside(self.folder, self.measurement.get("file", "drops.csv"))

    def wrong(self, key: str, message: str) -> InputError:
        """An error that names the line of ``dataset.toml`` where ``key`` stands."""
        path = self.folder / "dataset.toml"
        return _wrong(path, read_text(path), key, message)


@dataclass(frozen=True)
class Drops:
    """Drops in the order they were made: heights before and after in m.

    ``sigma_y_m`` is the declared uncertainty of a height, or None; optional columns are None
    where the table has none of them, and hold NaN where it has no value.
    """

    manifest: Manifest
    drop: Array
    y0_m: Array
    y1_m: Array
    contact_time_s: Array | None
    peak_force_N: Array | None
    session: tuple[str, ...] | None
    sigma_y_m: float | None


def read_manifest(folder: Path) -> Manifest:
    """Read ``dataset.toml`` in ``folder``.

    Raises InputError where it is missing, is no TOML, or declares something unusable.
    """
    folder = Path(folder)
    path = folder / "dataset.toml"
    text = read_text(path)
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    parts = {name: _part(path, tree, name) for name in PARTS}
    about = parts["dataset"]
    kind = about.get("kind")
    if kind not in KINDS:
        raise _wrong(path, text, "kind", f"must be one of {', '.join(KINDS)}, not {kind!r}")
    _refuse_misspelt(path, text, parts["body"], tuple(BODY_KEYS), all_known=True)
    _refuse_misspelt(path, text, parts["contact"], ("kn_N_m", "friction"))
    _refuse_misspelt(path, text, parts["measurement"], MEASUREMENT_KEYS)
    kn = _number(path, text, parts["contact"], "kn_N_m", None)
    measurement = dict(parts["measurement"])
    for key in NUMBER_KEYS:
        if key in measurement:
            measurement[key] = _number(path, text, measurement, key, None)
    if not isinstance(measurement.get("file", ""), str):
        raise _wrong(path, text, "file", "must be the name of a file")
    return Manifest(
        folder=folder,
        title=str(about.get("title", folder.name)),
        kind=kind,
        source=str(about.get("source", "")),
        licence=str(about.get("licence", "")),
        bristle=_bristle(path, text, parts["body"]),
        declared=tuple(sorted(parts["body"])),
        kn_N_m=kn,
        measurement=measurement,
        friction=_number(path, text, parts["contact"], "friction", paper.FRICTION) or 0.0,
    )


def read_drops(folder: Path) -> Drops:
    """Read a dataset of kind ``drops``; at least three drops.

    Raises InputError naming file and line of the first value that cannot be used.
    """
    manifest = read_manifest(folder)
    if manifest.kind != "drops":
        raise InputError(f"{manifest.folder / 'dataset.toml'}: kind is {manifest.kind}, not drops")
    path = manifest.table()
    rows = read_table(path, required=("drop", "y0_mm", "y1_mm"))
    if len(rows) < 3:
        raise InputError(f"{path}: {len(rows)} drops; a mean and its interval need three or more")
    drop = column(path, rows, "drop", whole=True)
    check_order(path, rows, "drop", drop)
    y0 = column(path, rows, "y0_mm", above=0.0)
    y1 = column(path, rows, "y1_mm", least=0.0)
    sigma = manifest.measurement.get("sigma_y_mm")
    return Drops(
        manifest=manifest,
        drop=drop,
        y0_m=1e-3 * y0,
        y1_m=1e-3 * y1,
        contact_time_s=optional_column(path, rows, "contact_time_ms", 1e-3),
        peak_force_N=optional_column(path, rows, "peak_force_N", 1.0),
        session=tuple(row["session"] for _, row in rows) if "session" in rows[0][1] else None,
        sigma_y_m=None if sigma is None else 1e-3 * sigma,
    )


def _part(path: Path, tree: Mapping[str, Any], name: str) -> dict[str, Any]:
    part = tree.get(name, {})
    if not isinstance(part, dict):
        raise InputError(f"{path}: {name} must be a table, written [{name}]")
    return part


def _line(text: str, key: str) -> int | None:
    pattern = re.compile(rf"^\s*[\"']?{re.escape(key)}[\"']?\s*=")
    return next((n for n, line in enumerate(text.splitlines(), 1) if pattern.match(line)), None)


def _wrong(path: Path, text: str, key: str, message: str) -> InputError:
    line = _line(text, key)
    return InputError(f"{path}{'' if line is None else f':{line}'}: {key} {message}")


def _refuse_misspelt(
    path: Path, text: str, part: Mapping[str, Any], known: tuple[str, ...], all_known: bool = False
) -> None:
    for key in part:
        if key in known:
            continue
        near = difflib.get_close_matches(key, known, n=1, cutoff=0.8)
        if near:
            raise _wrong(path, text, key, f"is not known; did you mean {near[0]}?")
        if all_known:
            raise _wrong(path, text, key, f"is not known; known are {', '.join(known)}")


def _number(
    path: Path, text: str, part: Mapping[str, Any], key: str, default: float | None
) -> float | None:
    if key not in part:
        return default
    value = part[key]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _wrong(path, text, key, f"must be a number, not {value!r}")
    if not math.isfinite(value):
        raise _wrong(path, text, key, f"must be finite, not {value}")
    zero_is_fine = key in ("damping_beta_s", "damping_alpha_1_s", "poisson_ratio", "friction")
    if value <= 0.0 and not zero_is_fine:
        raise _wrong(path, text, key, f"must be positive, not {value}")
    return float(value)


def _bristle(path: Path, text: str, part: Mapping[str, Any]) -> Bristle:
    if "diameter_m" in part and {"width_m", "thickness_m"} & set(part):
        raise _wrong(path, text, "diameter_m", "excludes width_m and thickness_m")
    n = {key: _number(path, text, part, key, default) or 0.0 for key, default in BODY_KEYS.items()}
    try:
        section: Section = Rectangle(n["thickness_m"], n["width_m"])
        if "diameter_m" in part:
            section = Circle(n["diameter_m"])
        material = Material(
            youngs_Pa=n["youngs_modulus_Pa"],
            poisson=n["poisson_ratio"],
            density_kg_m3=n["density_kg_m3"],
            alpha_1_s=n["damping_alpha_1_s"],
            beta_s=n["damping_beta_s"],
        )
        return Bristle(n["length_m"], section, material)
    except InputError as error:
        raise InputError(f"{path}: [body]: {error}") from error
