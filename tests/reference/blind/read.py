"""Datasets as files: drops or films read with errors, and what is declared of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from .body import Array, Body
from .drops import Truth
from .films import AT_RELEASE, HELD, MID_FALL, film
from .noise import ROUNDED, UNKNOWN, Draw, gaussian, rounded
from .size import Gauge
from .upright import GRAVITY_M_S2

Y1, TIME, FORCE = 0, 1, 2


@dataclass(frozen=True)
class Row:
    """A kind of dataset. ``holds`` is nothing, listed, pair, unlisted or gross, ``d`` (least, most)
    its size; ``others`` are the bodies beside the paper's."""

    name: str
    holds: str
    d: tuple[float, float] = (0.0, 0.0)
    films: bool = False
    noises: str = "mixed"
    others: tuple[Body, ...] = ()


@dataclass(frozen=True)
class Plan:
    """A drawn design: heights in the order of the drops, each drop's luck, what reads them."""

    truth: Truth
    gauge: Gauge
    heights_m: Array
    chance: Array
    friction_declared: bool


@dataclass(frozen=True)
class Found:
    """Drops without noise (drops, 4), what is in them and its size, where it is (a column) and
    the effect's parameter."""

    clear: Array
    truth: str
    d: float
    moved: int = Y1
    true: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Made:
    """A dataset, and what is in it.

    ``table`` is the file's text. ``moved`` is the column that an unlisted misfit is in,
    ``noise_mm`` what reading leaves of y1 against a height before that is read too. ``true`` has
    the parameters that a report may name, with their values.
    """

    row: str
    number: int
    kind: str
    truth: str
    d: float
    moved: int
    noise: str
    noise_mm: float
    columns: tuple[int, ...]
    n_drops: int
    manifest: str
    table: str
    true: dict[str, float] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "dataset.toml").write_text(self.manifest)
        (folder / f"{self.kind}.csv").write_text(self.table)

    def record(self) -> dict[str, Any]:
        """What is kept of it beside the verdict."""
        left_out = ("manifest", "table")
        return {
            each.name: getattr(self, each.name)
            for each in fields(self)
            if each.name not in left_out
        }


def measured(
    rng: np.random.Generator,
    row: Row,
    number: int,
    plan: Plan,
    found: Found,
) -> Made:
    """The data as they are read."""
    clear, truth = found.clear, found.truth
    noise, draw = _noise(rng, row)
    mark = rng.choice([5e-4, 1e-3]) if noise == ROUNDED else 0.0
    gauge = plan.gauge
    sigma = math.hypot(gauge.sigma_y_m, mark / math.sqrt(12.0))
    gauge = replace(gauge, sigma_y_m=sigma)
    if row.films:
        table, fps = _films(rng, plan, draw, mark)
    else:
        table, fps = _table(rng, gauge, plan.gauge.sigma_y_m, clear, draw, mark), 0.0
    known = {} if gauge.kn_N_m is not None else {"kn_N_m": plan.truth.kn_N_m}
    knowable = row.holds in ("nothing", "listed", "pair")
    share = 0.0 if row.films else float(np.mean((clear[:, 1] / clear[:, 0]) ** 2))
    kind = "tracks" if row.films else "drops"
    return Made(
        row=row.name,
        number=number,
        kind=kind,
        truth=truth,
        d=found.d,
        moved=found.moved,
        noise=noise,
        noise_mm=1e3 * sigma * math.sqrt(1.0 + share),
        columns=gauge.columns,
        n_drops=len(clear),
        manifest=_manifest(kind, plan, gauge, fps),
        table=table,
        true=known | found.true if knowable else {},
    )


def _noise(rng: np.random.Generator, row: Row) -> tuple[str, Draw]:
    if row.noises == "gaussian" or (row.noises == "mixed" and rng.random() < 0.6):
        return "gaussian", gaussian
    name = str(rng.choice(list(UNKNOWN)))
    return name, UNKNOWN[name]


def _table(
    rng: np.random.Generator, gauge: Gauge, sigma_y_m: float, clear: Array, draw: Draw, mark: float
) -> str:
    sigma = np.array([sigma_y_m, sigma_y_m, gauge.sigma_t_s, gauge.sigma_force_N])
    read = clear + sigma * draw((len(clear), 4), rng)
    if mark:
        read[:, :2] = rounded(read[:, :2], mark)
    read[:, 0] = np.maximum(read[:, 0], 1e-3)
    read[:, 1:] = np.maximum(read[:, 1:], [0.0, 1e-7, 1e-3])
    names = ["y0_mm", "y1_mm", "contact_time_ms", "peak_force_N"]
    keep = [0, *(1 + c for c in gauge.columns)]
    lines = [",".join(["drop", *(names[k] for k in keep)])]
    units = np.array([1e3, 1e3, 1e3, 1.0])
    for i, values in enumerate((read * units)[:, keep]):
        lines.append(",".join([str(i + 1), *(f"{value:.5f}" for value in values)]))
    return "\n".join(lines) + "\n"


def _films(rng: np.random.Generator, plan: Plan, draw: Draw, mark: float) -> tuple[str, float]:
    """All films of a set begin alike, at one of usual frame rates."""
    fps = float(rng.choice([120.0, 240.0, 300.0, 480.0]))
    begins = str(rng.choice([HELD, AT_RELEASE, MID_FALL]))
    if plan.truth.release_m_s:
        begins = HELD  # any other does not tell a push from an earlier release
    lines = ["drop,t_s,y_mm"]
    for i, (height, luck) in enumerate(zip(plan.heights_m, plan.chance, strict=True)):
        times, y = film(plan.truth, float(height), i, luck, fps, begins, rng)
        read = y + plan.gauge.sigma_y_m * draw((len(y), 1), rng)[:, 0]
        if mark:
            read = rounded(read, mark)
        lines += [f"{i + 1},{t:.6f},{1e3 * v:.5f}" for t, v in zip(times, read, strict=True)]
    return "\n".join(lines) + "\n", fps


def _manifest(kind: str, plan: Plan, gauge: Gauge, fps: float) -> str:
    """dataset.toml: the body and the instruments as they are declared, and nothing else."""
    body = gauge.body
    section = (
        [f"width_m = {body.width_m!r}", f"thickness_m = {body.thickness_m!r}"]
        if body.diameter_m is None
        else [f"diameter_m = {body.diameter_m!r}"]
    )
    contact = []
    if gauge.kn_N_m is not None:
        contact.append(f"kn_N_m = {gauge.kn_N_m:.6g}")
    if plan.friction_declared:
        contact.append(f"friction = {plan.truth.friction:.6g}")
    measured = [f'file = "{kind}.csv"', f"sigma_y_mm = {1e3 * gauge.sigma_y_m:.6g}"]
    if TIME in gauge.columns:
        measured.append(f"sigma_t_s = {gauge.sigma_t_s:.6g}")
    if FORCE in gauge.columns:
        measured.append(f"sigma_force_N = {gauge.sigma_force_N:.6g}")
    if fps:
        measured.append(f"fps = {fps!r}")
    lines = [
        "[dataset]",
        'title = "Rebounds"',
        f'kind = "{kind}"',
        'source = "a laboratory"',
        'licence = "none"',
        "",
        "[body]",
        f"length_m = {body.length_m!r}",
        *section,
        f"youngs_modulus_Pa = {body.youngs_Pa!r}",
        f"poisson_ratio = {body.poisson!r}",
        f"density_kg_m3 = {body.density_kg_m3!r}",
        f"damping_beta_s = {body.beta_s!r}",
        "",
        *(["[contact]", *contact, ""] if contact else []),
        "[measurement]",
        *measured,
        f"gravity_m_s2 = {GRAVITY_M_S2!r}",
    ]
    return "\n".join(lines) + "\n"
