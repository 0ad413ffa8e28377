"""A dataset of drops as a problem of the loop.

Rows are, drop after drop, the height after the impact and, where they were measured, the contact
time and the peak force. The height before it is measured too: its error is carried into all rows
of its drop, through the slope that the baseline and the data show. What is not declared is
unknown: friction, on which what leans hangs, the damping of a body that is described without one,
and the gain of a force sensor to within its class.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.polynomial import Legendre
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.bristle import Bristle, RigidMass
from .....solver.effects.base import Parameter
from .....solver.effects.library import EFFECTS
from .....solver.effects.outside import load_installed
from .....solver.errors import InputError
from ....data import datasets
from ....data.datasets import Manifest
from ....data.tables import LEAST_DROPS
from ...noise import Ints
from ...problem import Experiment, Model, Problem, refined_as
from ...responses.drop_model import DropModel, Drops
from ...responses.emulator import KN_RANGE_N_M, Emulator
from ...responses.rigid import RigidEmulator, rigid_emulator

KIND = "drops"
# A contact stiffness that is declared is taken as known to this share.
KN_KNOWN = 0.02
# What a force sensor shows over the force, where nobody declares it.
FORCE_GAIN = Parameter(
    "force_gain", "", 0.995, 1.005, 1.0, null=1.0, why="class 0.5 of ISO 7500-1: within 0.5 %"
)
# Uncertainty taken for heights where none is declared, until the scatter says better.
SIGMA_M = 1e-3
# At which effects are simulated beside a damping that nobody declared: between metals and joints.
BETA_UNKNOWN_S = 1e-7
# Of the ratio of data to baseline over the height: an error of its slope is one of a variance.
RATIO_DEGREE = 3
SCALES = (1e3, 1e6, 1.0)
# What is within reach: an electrical contact's timing, a piezo-electric cell under the plate, a
# ruler in the film's plane read to a tenth of a millimetre.
NEXT_TIME_S = 1e-6
NEXT_FORCE_N = 0.5
NEXT_HEIGHT_M = 1e-4
Build = Callable[[Drops, Mapping[int, float], tuple[str, ...]], DropModel]
NAMES = ("y1 (mm)", "contact time (µs)", "peak force (N)")


def read_problem(folder: Path) -> Problem:
    """The problem of a dataset's folder. Raises InputError."""
    return drops_problem(datasets.read_drops(folder))


def drops_problem(data: datasets.Drops) -> Problem:
    """The problem of a dataset of drops. Raises InputError where it cannot be one."""
    manifest = data.manifest
    measured, sigmas, notes = _measured(data)
    emulator = emulator_for(data.y0_m, manifest)
    drops = Drops(emulator, data.y0_m, data.drop - data.drop[0], tuple(measured))
    values = np.stack([measured[q] for q in drops.quantities], axis=1)
    keep = np.asarray(np.isfinite(values).all(axis=1))
    if not keep.all():
        drops = replace(drops, y0_m=drops.y0_m[keep], order=drops.order[keep])
        values = values[keep]
    for name in carried(KIND, drops.quantities):
        if EFFECTS[name].origin and not emulator.carries(name):
            notes[name] = "left aside: of a rigid body the loop knows its own effects alone"
    unwhitened = np.eye(len(measured))[None].repeat(len(values), 0)
    kn, beta = stiffness(manifest.kn_N_m, emulator), damping(manifest)
    gain = FORCE_GAIN if 2 in measured else None
    bare = DropModel(drops, kn, (), unwhitened, beta=beta, gain=gain)
    sigma = np.array([sigmas[q] for q in drops.quantities])
    start = _start(bare, values, sigma)
    predicted = bare.measured(start)[0]
    ratios = dict(zip(drops.quantities, _ratios(drops.y0_m, values, predicted, sigma), strict=True))
    whiten = _whitening(bare, start, sigma, ratios)
    n_q = len(drops.quantities)
    number = (drops.order + data.drop[0]).astype(np.int64)

    def model(effects: Sequence[str]) -> DropModel:
        return replace(bare, effects=tuple(effects), whiten=whiten)

    def proposed(other: Drops, known: Mapping[int, float], effects: tuple[str, ...]) -> DropModel:
        each = np.array([known[q] for q in other.quantities])
        plain = replace(bare, drops=other, whiten=np.eye(len(each))[None].repeat(len(other), 0))
        return replace(plain, effects=effects, whiten=_whitening(plain, start, each, ratios))

    # the last row of a Cholesky factor's inverse has its own scale on the diagonal
    scale = np.array([SCALES[q] for q in drops.quantities]) / np.einsum("dqq->dq", whiten)
    return Problem(
        values=np.einsum("dqr,dr->dq", whiten, values).ravel(),
        scale=scale.ravel(),
        unit="mm",
        quantity=np.tile(np.array([NAMES[q] for q in drops.quantities]), len(values)),
        group=np.repeat(number, n_q),
        covariates=_covariates(data, drops, keep),
        baseline=model(()),
        candidates=[
            model((name,))
            for name in carried(KIND, drops.quantities)
            if emulator.carries(name) and (beta is None or name != "material_damping")
        ],
        combine=model,
        experiments=experiments(drops, sigmas, proposed),
        confirm=None
        if emulator.no_solid
        else lambda effects, theta, groups: _solid(
            refined_as(model(effects), theta.size), theta, groups, number
        ),
        confirm_why=emulator.no_solid,
        sigma_declared=data.sigma_y_m is not None,
        notes=notes,
        warnings=data.doubts,
    )


def _solid(model: Model, theta: Array, groups: Ints, number: Ints) -> Array:
    """Whitened predictions by the 3-D model for the rows of drops numbered ``groups``."""
    from .solid import whitened_solid

    assert isinstance(model, DropModel)
    return whitened_solid(model, theta, groups, number)


def _covariates(data: datasets.Drops, drops: Drops, keep: NDArray[np.bool_]) -> dict[str, Array]:
    """By name (rows,); sessions are numbered as they first come."""
    found = {"height": drops.y0_m, "order": drops.order.astype(float)}
    if data.session is not None:
        number = {name: float(i) for i, name in enumerate(dict.fromkeys(data.session))}
        found["session"] = np.array([number[name] for name in data.session])[keep]
    return {name: np.repeat(values, len(drops.quantities)) for name, values in found.items()}


def carried(kind: str, quantities: Sequence[int]) -> list[str]:
    """The effects that such data can carry at all."""
    load_installed()
    names = [name for name, effect in EFFECTS.items() if kind in effect.kinds]
    if 1 not in quantities:  # no times: nothing shows a clock
        names.remove("clock_error")
    return names


def stiffness(declared_N_m: float | None, emulator: Emulator) -> Parameter:
    """Kn as the baseline's free parameter, held where the dataset declares it."""
    low, high = emulator.kn_range_N_m
    if declared_N_m is not None:
        low, high = declared_N_m * (1.0 - KN_KNOWN), declared_N_m * (1.0 + KN_KNOWN)
    typical = math.sqrt(low * high)
    return Parameter("kn_N_m", "N/m", low, high, typical, null=typical, logarithmic=True)


def damping(manifest: Manifest) -> Parameter | None:
    """β as a free parameter of the baseline where a body is described without it, else None."""
    if manifest.damping_declared or isinstance(manifest.body, RigidMass):
        return None
    return replace(EFFECTS["material_damping"].parameters[0], null=BETA_UNKNOWN_S)


def simulated_bristle(manifest: Manifest) -> Bristle:
    """The bristle of the tables; with a damping in the middle of all that may be, where it is not
    declared."""
    bristle = manifest.bristle
    if damping(manifest) is None:
        return bristle
    return replace(bristle, material=replace(bristle.material, beta_s=BETA_UNKNOWN_S))


def heights_about(y0_m: Array) -> tuple[float, float]:
    """Powers of two, in mm, that hold heights (drops,) and what effects make of them."""
    low = math.floor(math.log2(0.7 * 1e3 * float(y0_m.min())))
    high = math.ceil(math.log2(1.15 * 1e3 * float(y0_m.max())))
    return 1e-3 * 2.0**low, 1e-3 * 2.0**high


def emulator_for(y0_m: Array, manifest: Manifest) -> Emulator:
    """Tables of the body's drops: heights rounded outward, so that others can use them again."""
    place = heights_about(y0_m)
    if isinstance(manifest.body, RigidMass):
        return rigid_emulator(RigidEmulator, manifest, *place)
    low, high = KN_RANGE_N_M
    if manifest.kn_N_m is not None:
        low, high = min(low, manifest.kn_N_m / 10.0), max(high, 10.0 * manifest.kn_N_m)
    bristle = simulated_bristle(manifest)
    return Emulator(bristle, manifest.gravity_m_s2, *place, (low, high), friction=manifest.friction)


def _measured(
    data: datasets.Drops,
) -> tuple[dict[int, Array], dict[int, float], dict[str, str]]:
    """Quantities with an uncertainty, that uncertainty, and what was left aside."""
    measured, notes = {0: data.y1_m}, {}
    sigmas = {0: data.sigma_y_m or SIGMA_M}
    declared = data.manifest.measurement
    for q, values, key in (
        (1, data.contact_time_s, "sigma_t_s"),
        (2, data.peak_force_N, "sigma_force_N"),
    ):
        if values is None:
            continue
        if key not in declared:
            notes[NAMES[q]] = f"left aside: the dataset declares no {key}"
            continue
        measured[q], sigmas[q] = values, float(declared[key])
    if len(data.y1_m) < LEAST_DROPS:
        raise InputError(
            f"{data.manifest.table()}: {len(data.y1_m)} drops; the loop needs four or more"
        )
    if np.ptp(data.y1_m) == 0.0 < np.ptp(data.y0_m):
        raise InputError(
            f"{data.manifest.table()}: y1_mm is {1e3 * data.y1_m[0]:g} in every drop, whatever "
            "y0_mm; is the reading stuck?"
        )
    return measured, sigmas, notes


def _start(plain: DropModel, values: Array, sigmas: Array) -> Array:
    """The baseline's parameters (p,) that the middle of the drops asks for."""
    axes = [
        np.geomspace(each.low, each.high, 200 if i == 0 else 9)
        for i, each in enumerate(plain.parameters)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    miss = (((plain.measured(grid)[:, 0] - values) / sigmas) ** 2).sum(axis=2)
    return np.asarray(grid[int(np.argmin(np.median(miss, axis=1)))])


def _ratios(y0_m: Array, values: Array, predicted: Array, sigmas: Array) -> list[Legendre]:
    """Of each quantity, what is measured (drops, q) over what is ``predicted``, as a function of
    the height: a polynomial, whose degree the Bayesian information criterion chooses (G. Schwarz,
    Ann. Stat. 6 (1978) 461). Where an effect is strong its slope is not the baseline's."""
    n = len(y0_m)
    most = min(RATIO_DEGREE, n // 4 - 1, np.unique(y0_m).size - 2)
    out = []
    for value, expected, sigma in zip(values.T, predicted.T, sigmas, strict=True):
        ratio, weight = value / expected, np.abs(expected) / sigma
        fits = [Legendre.fit(y0_m, ratio, k, w=weight) for k in range(max(most, 0) + 1)]
        misses = [float(np.mean((weight * (ratio - each(y0_m))) ** 2)) for each in fits]
        costs = [n * math.log(max(miss, 1e-12)) + k * math.log(n) for k, miss in enumerate(misses)]
        out.append(fits[int(np.argmin(costs))])
    return out


def _whitening(plain: DropModel, at: Array, sigmas: Array, ratios: Mapping[int, Legendre]) -> Array:
    """Per drop, the inverse Cholesky factor of noise and of the error of y0, (drops, q, q).

    ``ratios`` by quantity are what is measured over the baseline's predictions.
    """
    step = 1e-3 * plain.drops.y0_m

    def expected(y0_m: Array) -> Array:
        drops = replace(plain.drops, y0_m=y0_m)
        found = replace(plain, drops=drops).measured(at)[0]
        for i, q in enumerate(drops.quantities):
            if q in ratios:
                found[:, i] *= ratios[q](np.clip(y0_m, *ratios[q].domain))
        return found

    change = expected(plain.drops.y0_m + step) - expected(plain.drops.y0_m - step)
    moved = sigmas[0] * change / (2.0 * step)[:, None]
    covariance = np.diag(sigmas**2) + np.einsum("dq,dr->dqr", moved, moved)
    return np.linalg.inv(np.linalg.cholesky(covariance))


def experiments(drops: Drops, sigmas: Mapping[int, float], build: Build) -> list[Experiment]:
    """Measurements that differ from ``drops`` in what is measured, how well, and from where.

    ``sigmas`` holds the standard deviation of each quantity (of `table.QUANTITIES`) in SI;
    ``build`` makes the model of such drops with effects in it.
    """

    def one(change: str, changed: Drops, better: Mapping[int, float]) -> Experiment:
        known = {q: better.get(q, sigmas.get(q, 0.0)) for q in changed.quantities}
        return Experiment(change, lambda effects: build(changed, known, effects))

    out = []
    for q, sigma, words in (
        (1, NEXT_TIME_S, "measure the contact time as well, to 1 µs, in as many drops"),
        (2, NEXT_FORCE_N, "measure the peak force as well, to 0.5 N, in as many drops"),
    ):
        if q not in drops.quantities:
            more = tuple(sorted((*drops.quantities, q)))
            out.append(one(words, replace(drops, quantities=more), {q: sigma}))
    if sigmas[0] > 1.5 * NEXT_HEIGHT_M:
        out.append(one("read the heights to 0.1 mm, in as many drops", drops, {0: NEXT_HEIGHT_M}))
    low, high = float(drops.y0_m.min()), float(drops.y0_m.max())
    ends = np.where(np.arange(len(drops)) % 2 == 0, low, high)
    words = f"make as many drops again, half from {1e3 * low:.0f} mm, half from {1e3 * high:.0f} mm"
    out.append(one(words, replace(drops, y0_m=ends), {}))
    return out
