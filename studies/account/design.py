"""Which cheap measurement would tell the surviving accounts apart, and after how many drops?

Every account is asked, with parameters drawn from its fit, what each instrument would show of
single drops. From means, scatter and what the fit leaves open follows how many drops decide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ...solver import paper
from ...solver.batch import Outcome
from ...solver.bristle import Array, Rectangle
from ..running.parallel import share_out
from .fit import Fit
from .library import Conditions, bristle_of, drops_under, no_tick, sound
from .models import CHANCES

SEED = 9025
HEIGHT_M = 0.05
# One-sided normal quantiles: 5 % false alarm, 95 % power.
Z_ALARM = Z_POWER = 1.6449
MOST_DROPS = 500


@dataclass(frozen=True)
class Setting:
    """How bristles are dropped: a lean given on purpose, another plate, another length."""

    lean_deg: float = 0.0
    mu: float | None = None
    length_m: float = paper.LENGTH_M


@dataclass(frozen=True)
class Instrument:
    """Something to measure on a drop.

    ``shows`` gives what a perfect instrument would read (n,); ``noise`` is the standard deviation
    of its own error, in the same unit. ``cost`` is 1 for what a film and a desk can do, 2 for
    simple electronics, 3 for gauges or sensors with fast recording.
    """

    name: str
    unit: str
    apparatus: str
    cost: int
    noise: float
    shows: Callable[[Outcome, Conditions, float, float], Array]
    setting: Setting = Setting()


def _ratio(o: Outcome, at: Conditions, beta_s: float, length_m: float) -> Array:
    return o.rebound_height_m / at.height_m


def _contact_time(o: Outcome, at: Conditions, beta_s: float, length_m: float) -> Array:
    return np.log10(o.contact_time_s)


def _peak(o: Outcome, at: Conditions, beta_s: float, length_m: float) -> Array:
    return np.log10(o.peak_force_N)


def _spin(o: Outcome, at: Conditions, beta_s: float, length_m: float) -> Array:
    return np.hypot(o.spin_x_rad_s, o.spin_y_rad_s)


def _tip_over_centre(o: Outcome, at: Conditions, beta_s: float, length_m: float) -> Array:
    return 1e3 * (o.rebound_height_m - o.cm_rebound_height_m)


def bending_strain(o: Outcome, at: Conditions, beta_s: float, length_m: float) -> Array:
    """Root mean square of surface strain (10^-6) over length and time of the ring after a bounce.

    Half of a ring's energy E is strain energy, whatever its modes: κ² = E / (EI L), strain κ t/2.
    E is what losses, the centre's rise and spin leave of the fall; an upright one has no bending.
    """
    bristle = bristle_of(beta_s, length_m)
    section = bristle.section
    assert isinstance(section, Rectangle)
    fall = bristle.mass_kg * paper.GRAVITY_M_S2 * at.height_m
    inertia = bristle.mass_kg * length_m**2 / 12.0
    kept = bristle.mass_kg * o.cm_velocity_after_m_s**2 / 2.0
    kept = kept + 0.5 * inertia * (o.spin_x_rad_s**2 + o.spin_y_rad_s**2)
    lost = o.material_loss_J + o.friction_loss_J + getattr(o, "contact_loss_J", 0.0)
    ring = np.where(at.lean_deg > 0.0, np.maximum(fall - lost - kept, 0.0), 0.0)
    stiffness = bristle.material.youngs_Pa * section.second_moment_x_m4 * length_m
    return 1e6 * 0.5 * section.thickness_m * np.sqrt(ring / stiffness)


def _decay(o: Outcome, at: Conditions, beta_s: float, length_m: float) -> Array:
    """Logarithm of the first axial mode's decay rate β ω²/2 in 1/s."""
    omega = 2.0 * math.pi / bristle_of(beta_s, length_m).axial_period_s
    return np.full(at.height_m.shape, math.log10(0.5 * beta_s * omega**2))


FILM_NOISE = 0.5e-3 * math.sqrt(2.0) / HEIGHT_M
CAMERA = "a telephone's slow motion, 240 frames/s, read to 0.5 mm"

INSTRUMENTS = (
    Instrument("y1/y0 again, fast film", "", f"50 mm, as before; {CAMERA}", 1, FILM_NOISE, _ratio),
    Instrument(
        "y1/y0 with a lean of 2°",
        "",
        f"the release tilted 2° toward the thin side against a plumb line; {CAMERA}",
        1,
        FILM_NOISE,
        _ratio,
        Setting(lean_deg=2.0),
    ),
    Instrument(
        "y1/y0 with a lean of 5°",
        "",
        f"the release tilted 5° toward the thin side; {CAMERA}",
        1,
        FILM_NOISE,
        _ratio,
        Setting(lean_deg=5.0),
    ),
    Instrument(
        "y1/y0, half the length",
        "",
        f"a bristle cut to 168 mm; {CAMERA}",
        1,
        FILM_NOISE,
        _ratio,
        Setting(length_m=0.5 * paper.LENGTH_M),
    ),
    Instrument(
        "y1/y0 on a rough plate",
        "",
        f"emery paper glued to the plate, μ = 0.8, Kn taken as unchanged; {CAMERA}",
        1,
        FILM_NOISE,
        _ratio,
        Setting(mu=0.8),
    ),
    Instrument(
        "y1/y0 on an oiled plate",
        "",
        f"oil on a smooth plate, μ = 0.05, Kn taken as unchanged; {CAMERA}",
        1,
        FILM_NOISE,
        _ratio,
        Setting(mu=0.05),
    ),
    Instrument(
        "spin after the bounce",
        "rad/s",
        "direction of the bristle in slow motion, 0.2° over 0.1 s of flight",
        1,
        0.05,
        _spin,
    ),
    Instrument(
        "tip above centre at the top",
        "mm",
        "apex of tip and of the middle, each read to 0.5 mm",
        1,
        0.7,
        _tip_over_centre,
    ),
    Instrument(
        "contact time",
        "decades",
        "plate painted with graphite, bristle in a circuit by a hair of wire, counter of 1 µs",
        2,
        0.01,
        _contact_time,
    ),
    Instrument(
        "peak force",
        "decades",
        "quartz load cell under a small plate, 100 kHz, 5 %",
        3,
        0.02,
        _peak,
    ),
    Instrument(
        "bending ring",
        "10^-6",
        "strain gauge at mid-length, thin wires, 5·10^-6; root mean square over the flight",
        3,
        5.0,
        bending_strain,
    ),
    Instrument(
        "decay of axial waves",
        "decades",
        "two gauges on opposite faces, bristle hung on threads and tapped on its end; 25 % a tap",
        3,
        0.1,
        _decay,
    ),
)


class Needed(NamedTuple):
    """How many drops tell two accounts apart by one instrument; infinite where none do.

    ``by`` is the mean, or the spread, whichever is quicker.
    """

    instrument: Instrument
    pair: tuple[str, str]
    difference: float
    scatter: float
    drops: float
    by: str


@dataclass(frozen=True)
class Trial:
    """How many parameter draws of each account, and drops of each draw, are simulated."""

    draws: int = 10
    drops: int = 24


def readings(
    fits: Sequence[Fit],
    comm: Any,
    tick: Callable[[], None] = no_tick,
    trial: Trial | None = None,
    instruments: Sequence[Instrument] = INSTRUMENTS,
) -> dict[tuple[str, str], Array]:
    """Values (draws, drops) by instrument and account, noise included, on all ranks. Collective.

    Drops whose budget does not close are NaN.
    """
    trial = trial or Trial()
    settings = tuple(dict.fromkeys(each.setting for each in instruments))
    jobs = [(each, setting, d) for each in fits for setting in settings for d in range(trial.draws)]
    pieces: dict[int, dict[str, Array]] = {}

    def work(i: int) -> dict[str, Array]:
        each, setting, d = jobs[i]
        return _drops(each, setting, d, trial, instruments)

    def take(i: int, values: dict[str, Array]) -> None:
        pieces[i] = values
        tick()

    share_out(comm, len(jobs), work, take)
    pieces = comm.bcast(pieces)
    found: dict[tuple[str, str], list[Array]] = {}
    for i, (each, _, _) in enumerate(jobs):
        for name, values in pieces[i].items():
            found.setdefault((name, each.account.key), []).append(values)
    return {key: np.array(rows) for key, rows in found.items()}


def count_jobs(n_fits: int, trial: Trial | None = None) -> int:
    """How often `readings` calls its ``tick``."""
    settings = {each.setting for each in INSTRUMENTS}
    return n_fits * len(settings) * (trial or Trial()).draws


def _drops(
    fit: Fit, setting: Setting, d: int, trial: Trial, instruments: Sequence[Instrument]
) -> dict[str, Array]:
    """What the instruments of one setting show of one parameter draw's drops."""
    account = fit.account
    random = np.random.default_rng([SEED, d])  # the same chances for all accounts and settings
    values = fit.draws(trial.draws, SEED)[d]
    chance = random.standard_normal((CHANCES, trial.drops))
    noise = random.standard_normal(trial.drops)
    height = np.full(trial.drops, HEIGHT_M)
    at = account.conditions(values, height, chance, setting.lean_deg)
    if setting.mu is not None:
        at = at._replace(mu=np.full(trial.drops, setting.mu))
    outcome = drops_under(at, bristle_of(account.beta_s, setting.length_m))
    good = sound(outcome)
    return {
        each.name: np.where(
            good,
            each.shows(outcome, at, account.beta_s, setting.length_m) + each.noise * noise,
            np.nan,
        )
        for each in instruments
        if each.setting == setting
    }


class Spread(NamedTuple):
    """Mean over all drops, standard deviation within a draw, and of the mean between draws."""

    mean: float
    within: float
    between: float


def spread(values: Array) -> Spread:
    """Of values (draws, drops), NaN left out; scatter of a draw's mean is taken off ``between``."""
    within2 = float(np.nanmean(np.nanvar(values, axis=1, ddof=1)))
    counts = np.count_nonzero(~np.isnan(values), axis=1)
    means = np.nanmean(values, axis=1)
    between2 = float(np.var(means, ddof=1)) - within2 * float(np.mean(1.0 / counts))
    return Spread(float(np.nanmean(values)), math.sqrt(within2), math.sqrt(max(between2, 0.0)))


def drops_needed(one: Spread, two: Spread) -> float:
    """Drops (1 or more) for 95 % power at 5 % false alarm, whichever of the two is true.

    The mean of n drops is normal with variance within²/n + between²; the least n at which the
    distance of the means is 1.645 (s1 + s2). Infinite where ``between`` alone forbids it.
    """
    distance = abs(one.mean - two.mean)

    def reach(n: float) -> float:
        s = (math.sqrt(each.within**2 / n + each.between**2) for each in (one, two))
        return Z_ALARM * next(s) + Z_POWER * next(s)

    if distance <= Z_ALARM * one.between + Z_POWER * two.between:
        return math.inf
    n = 1
    while reach(n) > distance:
        n += max(1, n // 50)
        if n > MOST_DROPS:
            return math.inf
    return float(n)


def needed(
    values: Mapping[tuple[str, str], Array],
    pair: tuple[str, str],
    instruments: Sequence[Instrument] = INSTRUMENTS,
) -> list[Needed]:
    """For every instrument, how many drops tell the pair apart, the fewest and cheapest first."""
    found = []
    for each in instruments:
        one, two = (values[each.name, key] for key in pair)
        by_mean = spread(one), spread(two)
        middle = 0.5 * (by_mean[0].mean + by_mean[1].mean)
        by_size = spread(np.abs(one - middle)), spread(np.abs(two - middle))
        n_mean, n_size = drops_needed(*by_mean), drops_needed(*by_size)
        quicker, by, n = (
            (by_mean, "mean", n_mean) if n_mean <= n_size else (by_size, "spread", n_size)
        )
        found.append(
            Needed(
                each,
                pair,
                quicker[1].mean - quicker[0].mean,
                math.sqrt(0.5 * (quicker[0].within ** 2 + quicker[1].within ** 2)),
                n,
                by,
            )
        )
    return sorted(found, key=lambda item: (item.drops, item.instrument.cost))
