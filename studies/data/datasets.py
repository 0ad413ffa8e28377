"""A dataset's folder: dataset.toml, with every value checked.

CONTRACT.md, "Datasets", gives the format. Reading is strict: a key that looks like a misspelt one,
a number that is none, a table that lies outside the folder each end with an InputError that names
file and line. What a dataset leaves out is the paper's bristle.
"""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...solver import paper
from ...solver.arrays import Array
from ...solver.bristle import Bristle, RigidMass
from ...solver.errors import InputError
from ..inputs import limits
from ..inputs.config import Inputs
from ..inputs.kinds import KINDS, load_installed
from ..inputs.sources import checked
from ..inputs.texts import exists, finite, line_of, parse_toml, printable, quoted
from .tables import Rows, column, in_order, inside, optional_column, read_table, read_text
from .units import check_contact_times, check_heights, check_peaks, doubtful_body

PARTS = ("dataset", "body", "contact", "measurement")
# The keys of a body, and the inputs of a drop that have their bounds.
BODY_KEYS = {
    "length_m": "length_m",
    "width_m": "width_m",
    "thickness_m": "thickness_m",
    "diameter_m": "diameter_m",
    "youngs_modulus_Pa": "youngs_Pa",
    "poisson_ratio": "poisson",
    "density_kg_m3": "density_kg_m3",
    "damping_beta_s": "beta_s",
    "damping_alpha_1_s": "alpha_1_s",
}
SHAPES = ("bristle", "rigid")
RIGID_KEYS = {"mass_kg": (1e-9, 1e6), "diameter_m": (1e-6, 100.0)}
# Beyond these no instrument is meant.
NUMBER_KEYS = {
    "sigma_y_mm": (1e-6, 1e6),
    "sigma_y0_mm": (1e-6, 1e6),
    "sigma_y_px": (1e-6, 1e6),
    "sigma_t_s": (1e-12, 1e3),
    "scale": (0.8, 1.25),
    "sigma_scale": (1e-6, 0.1),
    "sigma_surface_mm": (1e-6, 1e3),
    "sigma_surface_px": (1e-6, 1e3),
    "seen_width_mm": (1e-3, 1e3),
    "sigma_force_N": (1e-9, 1e9),
    "fps": (1e-3, 1e9),
    "gravity_m_s2": (1e-2, 300.0),
}
# A height may be read below zero by so many standard deviations, those of `SIGMA_MM` where none is
# declared.
BELOW, SIGMA_MM = 5.0, 1.0
KN_N_M, FRICTION = limits.USUAL["kn_N_m"][:2], (0.0, 100.0)
MOST_LETTERS = 1000
WAVE_KEYS = (
    *("signal", "gauge_x_m", "signal_2", "gauge_2_x_m", "unit", "sigma"),
    *("baseline_until_s", "first_pass_s", "predict_s"),
)
MEASUREMENT_KEYS = ("file", *NUMBER_KEYS, *WAVE_KEYS)


@dataclass(frozen=True)
class Manifest:
    """A ``dataset.toml``: its folder, what it declares, and the body that this makes.

    ``kn_N_m`` and ``friction`` are None where they are not declared; ``declared`` names the body's
    keys that are: none where it is the paper's bristle. ``body`` is a bristle, or a rigid mass
    where the shape is so.
    """

    folder: Path
    title: str
    kind: str
    source: str
    licence: str
    body: Bristle | RigidMass
    declared: tuple[str, ...]
    kn_N_m: float | None
    measurement: Mapping[str, Any]
    friction: float | None = None

    @property
    def damping_declared(self) -> bool:
        """Whether the body's damping is known; without any ``[body]`` it is the paper's bristle."""
        return not self.declared or "damping_beta_s" in self.declared

    @property
    def bristle(self) -> Bristle:
        """The bristle, or bar; InputError where the body is rigid."""
        if isinstance(self.body, RigidMass):
            raise self.wrong("shape", "is rigid: what was asked for needs a bristle or a bar")
        return self.body

    @property
    def gravity_m_s2(self) -> float:
        return float(self.measurement.get("gravity_m_s2", paper.GRAVITY_M_S2))

    def table(self, of: str = "") -> Path:
        """The measurement's table, which must lie in the folder; InputError where one ``of``
        something else than drops is not named."""
        if of and "file" not in self.measurement:
            raise self.wrong("file", f"must name the table of the {of}")
        return inside(self.folder, self.measurement.get("file", "drops.csv"))

    @property
    def lengths_left_out(self) -> list[str]:
        """Keys of a bristle's lengths that are not declared though a body is."""
        section = ("diameter_m",) if "diameter_m" in self.declared else ("width_m", "thickness_m")
        if not self.declared or isinstance(self.body, RigidMass):
            return []
        return [key for key in ("length_m", *section) if key not in self.declared]

    @property
    def lengths_doubt(self) -> str:
        """That lengths are the paper's for want of others; empty where they are declared."""
        left_out = " and ".join(self.lengths_left_out)
        return (
            f"[body] does not give {left_out}; taken from the paper's bristle" if left_out else ""
        )

    @property
    def unread(self) -> list[str]:
        """Keys of ``[measurement]`` that no kind of the program's own reads."""
        return [key for key in self.measurement if key not in MEASUREMENT_KEYS]

    def wrong(self, key: str, message: str) -> InputError:
        """An error that names the line of ``dataset.toml`` where ``key`` stands."""
        return _read(self.folder).wrong(key, message)

    def finite(self, key: str, value: object) -> float:
        """The ``value``, which stands under ``key``, as a number; InputError where it is none."""
        return _read(self.folder).finite(key, value)

    def check_sigma(self, key: str, unit: float, values: Array) -> None:
        """InputError where the uncertainty ``key`` exceeds all ``values``, in ``unit`` of it."""
        sigma = self.measurement.get(key)
        largest = np.nanmax(np.abs(values), initial=0.0) / unit
        if sigma is not None and sigma > largest > 0.0:
            raise self.wrong(key, f"of {sigma:g} is more than any value measured; is the unit so?")


@dataclass(frozen=True)
class Drops:
    """Drops in the order they were made: heights before and after in m.

    ``sigma_y_m`` is the declared uncertainty of a height, or None, and ``sigma_y0_m`` that of the
    height before. Where a cell is empty there is NaN; optional columns are None where the table has
    no value in them at all. ``again`` are the numbers of drops whose row stands twice.
    """

    manifest: Manifest
    drop: Array
    y0_m: Array
    y1_m: Array
    contact_time_s: Array | None
    peak_force_N: Array | None
    session: tuple[str, ...] | None
    sigma_y_m: float | None
    sigma_y0_m: float | None = None
    again: tuple[int, ...] = ()

    def of(self, which: NDArray[np.bool_]) -> Drops:
        """Those drops that ``which`` (drops,) tells."""
        chosen = {
            name: value[which]
            for name in ("drop", "y0_m", "y1_m", "contact_time_s", "peak_force_N")
            if (value := getattr(self, name)) is not None
        }
        if self.session is not None:
            chosen["session"] = tuple(itertools.compress(self.session, which))
        return replace(self, **chosen)

    def with_sigma(self, heights: float, times: float, forces: float) -> Drops:
        """The same with uncertainties that are so many times as large."""
        both = (self.sigma_y_m, self.sigma_y0_m)
        one, other = (None if each is None else heights * each for each in both)
        measurement = dict(self.manifest.measurement)
        for key, ratio in (("sigma_t_s", times), ("sigma_force_N", forces)):
            if key in measurement:
                measurement[key] = ratio * float(measurement[key])
        manifest = replace(self.manifest, measurement=measurement)
        return replace(self, manifest=manifest, sigma_y_m=one, sigma_y0_m=other)

    @property
    def complete(self) -> Drops:
        """The drops of which both heights were read."""
        return self.of(np.isfinite(self.y0_m) & np.isfinite(self.y1_m))

    @property
    def doubt(self) -> str:
        """What deserves doubt before all else: that most drops rise higher than they fell."""
        higher = int(np.count_nonzero(self.y1_m > self.y0_m))
        count = int(np.count_nonzero(np.isfinite(self.y1_m)))
        if 2 * higher <= count:
            return ""
        return (
            f"y1_mm exceeds y0_mm in {higher} of {count} drops, as if they gained energy; "
            "are the columns exchanged, or heights read from different marks?"
        )


def read_manifest(folder: Path, only: str | None = None) -> Manifest:
    """Read ``dataset.toml`` in ``folder``.

    Raises InputError where it is missing, is no TOML, declares something unusable, or a kind
    other than the ``only`` one that is asked for.
    """
    folder = Path(folder)
    read = _read(folder)
    tree = parse_toml(read.path, read.text)
    about, body, contact, measurement = (read.part(tree, name) for name in PARTS)
    kind = about.get("kind")
    load_installed()
    if kind is None:
        raise InputError(f"{read.path}: [dataset] needs kind, one of {', '.join(KINDS)}")
    if not isinstance(kind, str) or kind not in KINDS:
        raise read.wrong("kind", f"must be one of {', '.join(KINDS)}, not {quoted(kind)}")
    if only not in (None, kind):
        raise read.wrong("kind", f"is {kind}, not {only}")
    read.refuse_misspelt(body, ("shape", "mass_kg", *BODY_KEYS), all_known=True)
    read.refuse_misspelt(contact, ("kn_N_m", "friction"))
    read.refuse_misspelt(measurement, MEASUREMENT_KEYS)
    kn = read.number(contact, "kn_N_m", KN_N_M)
    friction = read.number(contact, "friction", FRICTION)
    measured = {key: read.number(measurement, key, NUMBER_KEYS[key]) for key in NUMBER_KEYS}
    measurement |= {key: value for key, value in measured.items() if value is not None}
    if not isinstance(measurement.get("file", ""), str):
        raise read.wrong("file", "must be the name of a file")
    return Manifest(
        folder=folder,
        title=read.words(about, "title") or folder.resolve().name,
        kind=kind,
        source=read.words(about, "source"),
        licence=read.words(about, "licence"),
        body=read.body(body),
        declared=tuple(sorted(body)),
        kn_N_m=kn,
        measurement=measurement,
        friction=friction,
    )


def read_drops(folder: Path) -> Drops:
    """Read a dataset of kind ``drops``; at least three drops of which both heights were read.

    Raises InputError naming file and line of the first value that cannot be used.
    """
    manifest = read_manifest(folder, "drops")
    path = manifest.table()
    rows = read_table(path, required=("drop", "y0_mm", "y1_mm"))
    if len(rows) < 3:
        raise InputError(
            f"{path}: too few drops, {len(rows)}: an interval needs three, the loop four"
        )
    rows, twice = _once(rows)
    rows, drop = in_order(path, rows, "drop")
    sigma, sigma_0 = (manifest.measurement.get(f"sigma_{y}_mm") for y in ("y", "y0"))
    y0 = column(path, rows, "y0_mm", above=0.0, empty=True)
    y1 = column(path, rows, "y1_mm", least=-BELOW * (sigma or SIGMA_MM), empty=True)
    both = int(np.count_nonzero(np.isfinite(y0 + y1)))
    if both < 3:
        raise InputError(f"{path}: both heights were read in {both} drops; three are needed")
    times = optional_column(path, rows, "contact_time_ms", 1e-3)
    off_N = BELOW * manifest.measurement.get("sigma_force_N", 0.0)
    peaks = optional_column(path, rows, "peak_force_N", 1.0, least=-off_N)
    lines = [line for line, _ in rows]
    check_heights(path, lines, 1e-3 * y0, 1e-3 * y1)
    manifest.check_sigma("sigma_y_mm", 1e-3, 1e-3 * y0)
    manifest.check_sigma("sigma_y0_mm", 1e-3, 1e-3 * y0)
    if times is not None:
        check_contact_times(path, lines, "contact_time_ms", times, manifest.body)
        manifest.check_sigma("sigma_t_s", 1.0, times)
    if peaks is not None:
        whose = manifest.body, manifest.gravity_m_s2
        check_peaks(path, lines, "peak_force_N", peaks, 1e-3 * y0, *whose, off_N)
        manifest.check_sigma("sigma_force_N", 1.0, peaks)
    return Drops(
        manifest=manifest,
        drop=drop,
        y0_m=1e-3 * y0,
        y1_m=1e-3 * y1,
        contact_time_s=_unless_empty(times),
        peak_force_N=_unless_empty(peaks),
        session=tuple(row["session"] for _, row in rows) if "session" in rows[0][1] else None,
        sigma_y_m=None if sigma is None else 1e-3 * sigma,
        sigma_y0_m=None if sigma_0 is None else 1e-3 * sigma_0,
        again=tuple(int(n) for n in column(path, twice, "drop", whole=True)),
    )


def _once(rows: Rows) -> tuple[Rows, Rows]:
    """The rows without those that say what an earlier one does, number and all; and these."""
    said: set[tuple[str, ...]] = set()
    first, again = Rows(), Rows()
    for line, row in rows:
        words = tuple(row.values())
        (again if words in said else first).append((line, row))
        said.add(words)
    return first, again


def _unless_empty(values: Array | None) -> Array | None:
    """A column; None where it has no value at all."""
    return None if values is None or np.isnan(values).all() else values


def _read(folder: Path) -> _Declarations:
    path = inside(folder, "dataset.toml")
    if not exists(folder):
        raise InputError(f"{folder}: there is no such folder")
    if not exists(path) and not path.is_symlink():
        raise InputError(
            f"{path}: is missing, without which nothing says what was measured; "
            "docs/measurements.md shows how to write it, and `bristle track` makes it from films"
        )
    return _Declarations(path, read_text(path))


@dataclass(frozen=True)
class _Declarations:
    """The text of a ``dataset.toml``, whose errors name its lines."""

    path: Path
    text: str

    def place(self, key: str) -> str:
        line = line_of(self.text, key)
        return f"{self.path}{'' if line is None else f':{line}'}: {key}"

    def wrong(self, key: str, message: str) -> InputError:
        return InputError(f"{self.place(key)} {message}")

    def part(self, tree: Mapping[str, Any], name: str) -> dict[str, Any]:
        part = tree.get(name, {})
        if not isinstance(part, dict):
            raise InputError(f"{self.path}: {name} must be a table, written [{name}]")
        return part

    def refuse_misspelt(
        self, part: Mapping[str, Any], known: tuple[str, ...], all_known: bool = False
    ) -> None:
        for key in part:
            if key in known:
                continue
            near = [each for each in known if each.startswith(f"{key}_")]  # without its unit
            near += difflib.get_close_matches(key, known, cutoff=0.8)
            near.sort(key=lambda each: (not each.startswith(key), known.index(each)))
            if near:
                raise self.wrong(key, f"is not known; did you mean {near[0]}?")
            if all_known:
                raise self.wrong(key, f"is not known; known are {', '.join(known)}")

    def words(self, part: Mapping[str, Any], key: str) -> str:
        """A text of ``[dataset]`` on one line, without what would steer a terminal."""
        words = part.get(key, "")
        if not isinstance(words, str) or len(words) > MOST_LETTERS:
            raise self.wrong(key, f"must be a text of at most {MOST_LETTERS} letters")
        return printable(words)

    def finite(self, key: str, value: object) -> float:
        number = finite(value)
        if number is None:
            raise self.wrong(key, f"must be a finite number, not {quoted(value)}")
        return number

    def number(
        self, part: Mapping[str, Any], key: str, between: tuple[float, float]
    ) -> float | None:
        """The number, None where it is not declared."""
        if key not in part:
            return None
        number, (low, high) = self.finite(key, part[key]), between
        if number <= 0.0 < low:
            raise self.wrong(key, f"must be positive, not {number:g}")
        if not low <= number <= high:
            raise self.wrong(key, f"must lie between {low:g} and {high:g}, not {number:g}")
        return number

    def body(self, part: Mapping[str, Any]) -> Bristle | RigidMass:
        """The body of the shape that is declared."""
        shape = part.get("shape", SHAPES[0])
        if shape not in SHAPES:
            raise self.wrong("shape", f"must be one of {', '.join(SHAPES)}, not {quoted(shape)}")
        rest = {key: value for key, value in part.items() if key != "shape"}
        if shape == SHAPES[0]:
            return self.bristle(rest)
        for key in rest:
            if key not in RIGID_KEYS:
                words = "is not for a rigid body: it has mass_kg and diameter_m"
                raise self.wrong(key, words)
        mass, diameter = (self.number(rest, key, RIGID_KEYS[key]) for key in RIGID_KEYS)
        if mass is None:
            raise self.wrong("shape", "of rigid needs mass_kg")
        return RigidMass(mass, diameter)

    def bristle(self, part: Mapping[str, Any]) -> Bristle:
        """The bristle that is declared, within the bounds of a drop's inputs."""
        if "mass_kg" in part:
            raise self.wrong("mass_kg", 'is for shape = "rigid" alone')
        if "diameter_m" in part and {"width_m", "thickness_m"} & set(part):
            raise self.wrong("diameter_m", "excludes width_m and thickness_m")
        values = {BODY_KEYS[key]: self.finite(key, value) for key, value in part.items()}
        origins = {BODY_KEYS[key]: self.place(key) for key in part}
        bristle = checked(Inputs, values, origins).bristle()
        doubt = doubtful_body(bristle, part)
        if doubt is not None:
            raise self.wrong(*doubt)
        return bristle
