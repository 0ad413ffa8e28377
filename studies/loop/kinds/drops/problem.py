"""A dataset of drops as a problem of the loop.

Rows are, drop after drop, the height after the impact, the contact time and the peak force, each
where it was read. The height before it is measured too: its error is carried into all rows of its
drop, through the slope that the baseline and the data show or, where heights hardly differ, that
of each model (`Errors`). What is not declared is
unknown: friction, on which what leans hangs, the damping of a body that is described without one,
and the gain of a force sensor to within its class.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from ...problem import Entry, Experiment, Model, Problem, undeclared
from ...responses.drop_model import STEP, BounceModel, DropModel, Drops
from ...responses.emulator import KN_RANGE_N_M, Emulator
from ...responses.errors import Errors
from ...responses.rigid import RigidEmulator, rigid_emulator
from ...responses.sessions import Partings
from .bookkeeping import Table, misread

KIND = "drops"
# A contact stiffness that is declared is taken as known to this share.
KN_KNOWN = 0.02
# What a force sensor shows over the force, where nobody declares it.
FORCE_GAIN = Parameter(
    "force_gain", "", 0.995, 1.005, 1.0, null=1.0, why="class 0.5 of ISO 7500-1: within 0.5 %"
)
# Uncertainty taken for heights where none is declared, until the scatter says better.
SIGMA_M = 1e-3 * datasets.SIGMA_MM
# At which effects are simulated beside a damping that nobody declared: between metals and joints.
BETA_UNKNOWN_S = 1e-7
# Of the ratio of data to baseline over the height: an error of its slope is one of a variance.
RATIO_DEGREE = 3
# Sum of squares, in standard deviations, of what a slope that is too small leaves, from which on
# errors of the heights count as those of every model: a tenth of one value's noise.
DILUTED = 0.1
# Standard deviations by which heights that were set lie apart at least. Of several readings of one
# height neighbours lie closer.
SET_APART = 2.0
# Standard errors of a variance within which heights are one height.
ONE_HEIGHT = 3.0
# Numbers missing, over the usual step between them, after which another session began.
MISSING = 10.0
# What the session of drops is called whose cell for it is empty.
NAMELESS = "no name"
# Standard deviations by which a fitted height may differ from the one that was read.
MOST_SHIFTED = 3.0
SCALES = (1e3, 1e6, 1.0)
# What is within reach: an electrical contact's timing, a piezo-electric cell under the plate, a
# ruler in the film's plane read to a tenth of a millimetre.
NEXT_TIME_S = 1e-6
NEXT_FORCE_N = 0.5
NEXT_HEIGHT_M = 1e-4
Build = Callable[[Drops, Mapping[int, float], tuple[str, ...]], DropModel]
# As a table has them.
COLUMNS, IN_TABLE = ("y1_mm", "contact_time_ms", "peak_force_N"), (1e3, 1e3, 1.0)
NAMES = ("y1 (mm)", "contact time (µs)", "peak force (N)")


def read_problem(folder: Path) -> Problem:
    """The problem of a dataset's folder. Raises InputError."""
    data = datasets.read_drops(folder)
    why = "this row stands twice, with its number; one is kept"
    return drops_problem(data, tuple(Entry("repeated", (drop,), why) for drop in data.again))


def drops_problem(data: datasets.Drops, wrong: tuple[Entry, ...] = ()) -> Problem:
    """The problem of a dataset of drops; ``wrong`` is what its table had wrong, and is set aside.

    Raises InputError where it cannot be one.
    """
    whole, aside, undone = data, wrong, False
    while True:
        every = whole.of(~np.isin(whole.drop, [n for each in aside for n in each.rows]))
        data = every.of(np.isfinite(every.y0_m))
        bare, values, notes = _bare(data)
        start = _start(bare, values, bare.errors.sigma)
        slips = math.inf if undone else sum(each.slips for each in aside)
        entries, too_many = _misread(data, bare, start, values, slips)
        if too_many and any(each.numbers > 1 for each in aside):
            # what moves several numbers of many drops is physics
            aside, undone = tuple(each for each in aside if each.numbers == 1), True
        elif entries:
            aside = (*aside, *entries)
        else:
            break
    seen = _seen(bare, start, values)
    partings = _partings(data)
    if partings.possible.size:
        # until it is seen what data ask for, in the middle of what may be
        middle = np.arange(partings.possible.size) == partings.possible.size // 2
        partings = partings.parted(np.where(middle, 0.0, -np.inf))
    bare = replace(bare, drops=replace(bare.drops, session=partings.second, partings=partings))
    drops, emulator, errors = bare.drops, bare.emulator, seen.errors
    number = np.broadcast_to(data.drop.astype(np.int64)[:, None], values.shape)

    def model(effects: Sequence[str]) -> DropModel:
        return replace(bare, effects=tuple(effects), errors=errors)

    def confirm(found: Model, theta: Array, groups: Ints) -> Array:
        from .solid import whitened_solid

        assert isinstance(found, DropModel)
        return whitened_solid(found, theta, groups, number[:, 0])

    # the last row of a Cholesky factor's inverse has its own scale on the diagonal
    whiten = np.einsum("dqq->dq", errors.whiten)
    scale = np.array([SCALES[q] for q in drops.quantities]) / whiten
    names = np.array([NAMES[q] for q in drops.quantities])
    listed = ", ".join(f"{each:g}" for each in every.drop[~np.isfinite(every.y0_m)])
    sigmas = dict(zip(drops.quantities, map(float, errors.sigma), strict=True))
    return Problem(
        values=errors.rows(values),
        scale=scale[errors.present],
        unit="mm",
        quantity=np.broadcast_to(names, values.shape)[errors.present],
        main=NAMES[0],
        group=number[errors.present],
        covariates=_covariates(data, drops, seen.height_m, errors.present),
        baseline=model(()),
        candidates=[
            model((name,))
            for name in carried(KIND, drops.quantities)
            if emulator.carries(name)
            and (bare.beta is None or name != "material_damping")
            and (partings.possible.size or name != "session")
        ],
        combine=model,
        experiments=experiments(drops, sigmas, _proposed(bare, start, seen.ratios)),
        confirm=None if emulator.no_solid else confirm,
        confirm_why=emulator.no_solid,
        sigma_declared=data.sigma_y_m is not None,
        warnings=(*undeclared("sigma_y_mm", data.sigma_y_m), *_many_sessions(partings)),
        notes=notes,
        lead=data.doubt,
        left_aside=(f"drops without y0_mm: {listed}",) if listed else (),
        bookkeeping=aside,
        with_sigma=lambda times: drops_problem(
            every.with_sigma(*(times.get(name, 1.0) for name in NAMES)), aside
        ),
    )


def _bare(data: datasets.Drops) -> tuple[DropModel, Array, dict[str, str]]:
    """The model without effects, with errors that have nothing in common yet; what is measured
    (drops, q); and notes for the reader."""
    manifest = data.manifest
    measured, sigmas, notes = _measured(data)
    emulator = emulator_for(data.y0_m, manifest)
    drops = Drops(emulator, data.y0_m, order_of(data.drop), tuple(measured))
    values = np.stack([measured[q] for q in drops.quantities], axis=1)
    for name in carried(KIND, drops.quantities):
        if EFFECTS[name].origin and not emulator.carries(name):
            notes[name] = "left aside: of a rigid body the loop knows its own effects alone"
    kn, beta = stiffness(manifest.kn_N_m, emulator), damping(manifest)
    sigma = np.array([sigmas[q] for q in drops.quantities])
    errors = Errors.independent(sigma, np.isfinite(values), data.sigma_y0_m or sigmas[0])
    gain = FORCE_GAIN if 2 in measured else None
    return DropModel(drops, kn, (), errors, beta=beta, gain=gain), values, notes


@dataclass(frozen=True)
class _Seen:
    """What data show of the height before: the ``errors`` that it causes, the heights (drops,) as
    all readings have them, what the expectation leaves (drops, q) in sigma, and ``ratios`` of data
    to baseline over the height, by quantity."""

    errors: Errors
    height_m: Array
    left: Array
    ratios: Mapping[int, Legendre]


def _seen(bare: DropModel, start: Array, values: Array) -> _Seen:
    plain, drops = bare.errors, bare.drops
    predicted = bare.measured(start)[0]
    close = _close_together(drops.y0_m, plain.sigma_y0_m)
    fits = _ratios(drops.y0_m, values, predicted, plain.sigma, 0 if close else RATIO_DEGREE)
    ratios = dict(zip(drops.quantities, fits, strict=True))
    slopes = _slopes(bare, start, ratios)
    errors = replace(plain, whiten=plain.factors(slopes), values=values if close else None)
    expected = predicted * np.stack([each(drops.y0_m) for each in fits], axis=1)
    height_m = drops.y0_m
    if _one_height(drops.y0_m, plain.sigma_y0_m):
        height_m = np.full(len(drops), float(np.mean(drops.y0_m)))
    elif close:
        height_m = _fitted_heights(height_m, errors, slopes, values - expected)
    left = (values - expected) / np.hypot(plain.sigma, plain.sigma_y0_m * slopes)
    return _Seen(errors, height_m, left, ratios)


def _proposed(bare: DropModel, start: Array, ratios: Mapping[int, Legendre]) -> Build:
    """What builds models of other drops, with the errors that these have shown."""
    sigma_0, sigma_y = bare.errors.sigma_y0_m, float(bare.errors.sigma[0])

    def build(other: Drops, known: Mapping[int, float], effects: tuple[str, ...]) -> DropModel:
        each = np.array([known[q] for q in other.quantities])
        least = sigma_0 * min(1.0, known[0] / sigma_y)
        plain = Errors.independent(each, np.ones((len(other), each.size), dtype=bool), least)
        unlike = replace(bare, drops=other, effects=(), errors=plain)
        own = replace(plain, whiten=plain.factors(_slopes(unlike, start, ratios)))
        return replace(unlike, effects=effects, errors=own)

    return build


def _misread(
    data: datasets.Drops, bare: DropModel, start: Array, values: Array, before: float
) -> tuple[list[Entry], bool]:
    """`misread` of the data's table."""

    def predict(y0_m: Array) -> Array:
        others = replace(bare.drops, y0_m=y0_m, order=np.zeros(len(y0_m)))
        return np.asarray(replace(bare, drops=others).measured(start)[0])

    errors, quantities = bare.errors, bare.drops.quantities
    moved = errors.sigma_y0_m * _slopes(bare, start, {})
    table = Table(
        number=data.drop.astype(np.int64),
        y0_m=data.y0_m,
        values=values,
        sigma=np.hypot(errors.sigma, moved),
        sigma_y0_m=errors.sigma_y0_m,
        columns=tuple(COLUMNS[q] for q in quantities),
        unit=tuple(IN_TABLE[q] for q in quantities),
        predict=predict,
    )
    return misread(table, before)


def _covariates(
    data: datasets.Drops, drops: Drops, height_m: Array, present: NDArray[np.bool_]
) -> dict[str, Array]:
    """By name (rows,); sessions are numbered as they first come."""
    found = {"height": height_m, "order": drops.order.astype(float)}
    if data.session is not None:
        number = {name: float(i) for i, name in enumerate(dict.fromkeys(data.session))}
        found["session"] = np.array([number[name] for name in data.session])
    return {
        name: np.broadcast_to(values[:, None], present.shape)[present]
        for name, values in found.items()
    }


def _close_together(y0_m: Array, sigma_y0_m: float) -> bool:
    """Whether heights differ so little that a slope over them, as measured, is too small by as much
    as data of this number would show.

    It is too small by the variance of the errors over that of the heights. What this leaves has a
    sum of squares of at most that share times the number of drops, in standard deviations.
    Heights that come again and again to the last digit, and lie farther apart than they err, were
    set and not read: what they are off by makes no slope too small (J. Berkson, J. Am. Stat. Assoc.
    45 (1950) 164). Readings of one height lie closer, however coarse the ruler.
    """
    levels = np.unique(y0_m)
    apart = float(np.diff(levels).min(initial=np.inf))
    if 2 * levels.size <= len(y0_m) and apart > SET_APART * sigma_y0_m:
        return False
    spread = float(np.var(y0_m))
    return len(y0_m) * sigma_y0_m**2 > DILUTED * spread


def _one_height(y0_m: Array, sigma_y0_m: float) -> bool:
    """Whether heights differ by no more than they err: then nothing can hang on them, and heights
    that are fitted to what scatters for another reason would follow it."""
    n = len(y0_m)
    most = sigma_y0_m**2 * (1.0 + ONE_HEIGHT * math.sqrt(2.0 / (n - 1)))
    return bool(np.var(y0_m, ddof=1) < most)


def _slopes(plain: DropModel, at: Array, ratios: Mapping[int, Legendre]) -> Array:
    """Slopes (drops, q) over the height of what is expected: the baseline's predictions times what
    is measured over them, ``ratios`` by quantity."""
    y0_m = plain.drops.y0_m

    def expected(y0_m: Array) -> Array:
        drops = replace(plain.drops, y0_m=y0_m)
        found = replace(plain, drops=drops).measured(at)[0]
        for i, q in enumerate(drops.quantities):
            if q in ratios:
                found[:, i] *= ratios[q](np.clip(y0_m, *ratios[q].domain))
        return found

    step = STEP * y0_m
    return np.asarray((expected(y0_m + step) - expected(y0_m - step)) / (2.0 * step)[:, None])


def _fitted_heights(y0_m: Array, errors: Errors, slopes: Array, left: Array) -> Array:
    """Heights (drops,) as all readings of each drop have them; ``left`` (drops, q) is what the
    expectation at the height as read leaves. What it leaves is independent of these heights, and
    not of those that were read."""
    moved = np.where(errors.present, errors.sigma_y0_m * slopes, 0.0)
    weight = 1.0 / errors.sigma**2
    known = np.where(errors.present, left, 0.0)
    shift = np.sum(moved * weight * known, axis=1) / (1.0 + np.sum(moved**2 * weight, axis=1))
    return y0_m + errors.sigma_y0_m * np.clip(shift, -MOST_SHIFTED, MOST_SHIFTED)


def order_of(drop: Array) -> Array:
    """Drops (drops,) counted from zero by their numbers; what was not numbered between two sessions
    was not made."""
    step = np.diff(drop, prepend=drop[:1])
    return np.asarray(np.cumsum(np.where(_later(drop), 1.0, step)))


def _later(drop: Array) -> NDArray[np.bool_]:
    """Whether so many numbers are missing before a drop (drops,) that it began a session."""
    step = np.diff(drop, prepend=drop[:1])
    usual = float(np.median(step[1:])) if step.size > 1 else 1.0
    return np.asarray(step > MISSING * max(usual, 1.0))


def _many_sessions(partings: Partings) -> tuple[str, ...]:
    """A doubt where the table tells more sessions than the loop can tell apart at once."""
    count = int(partings.label.max()) + 1
    if count < 3:
        return ()
    empty = ", the drops without a name among them" * (NAMELESS in partings.names)
    return (
        f"the table has {count} sessions{empty}; the loop compares earlier ones with later ones, "
        "or one with all others: if they differ otherwise, close the loop on two of them at a time",
    )


def _partings(data: datasets.Drops) -> Partings:
    """How these drops may be parted into two sessions."""
    if data.session is None:
        return Partings(data.drop, np.cumsum(_later(data.drop)))
    session = [each or NAMELESS for each in data.session]
    names = tuple(dict.fromkeys(session))
    return Partings(data.drop, np.array([names.index(each) for each in session]), names)


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
            f"{data.manifest.table()}: {len(data.y1_m)} drop{'s' * (len(data.y1_m) != 1)}; the "
            "loop needs four or more, and rows with the same numbers count once"
        )
    least, most = np.nanmin(data.y1_m), np.nanmax(data.y1_m)
    if least == most and np.ptp(data.y0_m) > 0.0:
        raise InputError(
            f"{data.manifest.table()}: y1_mm is {1e3 * least:g} in every drop, whatever "
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
    miss = np.nansum(((plain.everywhere(grid)[:, 0] - values) / sigmas) ** 2, axis=2)
    return np.asarray(grid[int(np.argmin(np.median(miss, axis=1)))])


def _ratios(
    y0_m: Array, values: Array, predicted: Array, sigmas: Array, most: int
) -> list[Legendre]:
    """Of each quantity, what is measured (drops, q) over what is ``predicted``, as a function of
    the height: a polynomial of ``most`` degrees, which the Bayesian information criterion chooses
    (G. Schwarz, Ann. Stat. 6 (1978) 461). Where an effect is strong its slope is not the
    baseline's."""
    out = []
    low, high = float(y0_m.min()), float(y0_m.max())
    domain = [low, high if high > low else 1.01 * low]  # slopes are asked for at every height
    for value, expected, sigma in zip(values.T, predicted.T, sigmas, strict=True):
        there = np.isfinite(value)
        x, n = y0_m[there], int(np.sum(there))
        ratio = np.asarray(value / expected)[there]
        weight = np.asarray(np.abs(expected) / sigma)[there]
        highest = max(min(most, n // 4 - 1, np.unique(x).size - 2), 0)
        fits = [Legendre.fit(x, ratio, k, w=weight, domain=domain) for k in range(highest + 1)]
        misses = [float(np.mean((weight * (ratio - each(x))) ** 2)) for each in fits]
        costs = [n * math.log(max(miss, 1e-12)) + k * math.log(n) for k, miss in enumerate(misses)]
        out.append(fits[int(np.argmin(costs))])
    return out


def experiments(drops: Drops, sigmas: Mapping[int, float], build: Build) -> list[Experiment]:
    """Measurements that differ from ``drops`` in what is measured, how well, and from where.

    ``sigmas`` holds the standard deviation of each quantity (of `table.QUANTITIES`) in SI;
    ``build`` makes the model of such drops with effects in it.
    """

    def one(change: str, changed: Drops, better: Mapping[int, float]) -> Experiment:
        known = {q: better.get(q, sigmas.get(q, 0.0)) for q in changed.quantities}

        def models(found: Model) -> DropModel:
            assert isinstance(found, BounceModel)
            session, partings = found.drops.session, found.drops.partings
            parted = replace(changed, session=session, partings=partings)
            return build(parted, known, found.effects)

        return Experiment(change, models)

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
