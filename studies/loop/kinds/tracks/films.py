"""The films of a dataset as tracks: which can be used, in which unit, and how frames scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .....solver.arrays import Array
from .....solver.bristle import RigidMass
from .....solver.errors import InputError
from ....data.tables import LEAST_DROPS
from .common import together
from .flight import heights, rises_of
from .lean import doubts_of_lean, with_lean
from .phases import phases
from .record import Tracks
from .rows import Film, Track, reduced
from .scale import pixel_m, turned
from .search import track

FASTER_FPS, FASTER = 250.0, 4.0
MOST_OFF_M = 5e-3
"""How far the surface may be from a declared zero of the heights: what an eye would not see."""
BEYOND_CHANCE = 4.0
"""Standard errors beyond which the scatter of frames is another than declared."""
MOST_BOUNCES = 8
MOST_MEMORY = 0.95
MANY = 200
"""Frames beyond what tracks take up, with which their scatter is known to a twentieth."""
STRAYING = 4.0
"""How many times farther than others' the frames of a film lie from any parabolas."""


@dataclass(frozen=True)
class Filmed:
    """The films that can be used, their tracks and numbers; what a pixel is in m, for films in
    pixels; by how much each bristle leans, with its standard error (2, films), and what the user is
    to know of the rest."""

    films: Sequence[Film]
    tracks: Sequence[Track]
    number: NDArray[np.int64]
    pixel_m: float | None
    floor_known: bool
    sigma_y_m: float
    sigma_known: bool
    warnings: tuple[str, ...]
    left_aside: tuple[str, ...]
    lean_deg: Array

    @property
    def faster_fps(self) -> float:
        """A rate worth filming at next."""
        frame = np.median([np.median(np.diff(film.t_s)) for film in self.films])
        return max(FASTER_FPS, float(f"{FASTER / frame:.2g}"))


def filmed(data: Tracks) -> Filmed:
    """The films of a dataset. Raises InputError where too few can be used."""
    pixel, films = _in_metres(data)
    # a ball bounces again as it did first, a bristle rings and leans
    bounces = MOST_BOUNCES if isinstance(data.manifest.body, RigidMass) else 1
    films, found, warnings = _over_a_surface(films, bounces)
    straying = _straying(found)
    found = [None if i in straying else each for i, each in enumerate(found)]
    declared = data.sigma_y_m is not None or (data.in_pixels and data.sigma_y_px is not None)
    # the rough uncertainty with which the search began is mended twice
    for _ in range(0 if declared else 2):
        by = np.sqrt(_scatter(found)[0])
        films = [replace(film, sigma_y_m=film.sigma_y_m * by) for film in films]
        found = [None if i in straying else track(film, bounces) for i, film in enumerate(films)]
    if _usable(found) < LEAST_DROPS:
        raise _refusal(data, films, found)
    scatter, count, memory = _scatter(found)
    sigma = films[0].sigma_y_m
    wider = np.sqrt((1.0 + memory) / (1.0 - memory))
    if declared:
        wider *= np.sqrt(max(scatter, 1.0)) if _is_off(scatter, count) else 1.0
    good = [i for i, each in enumerate(found) if each is not None]
    films = [films[i] for i in good]
    tracks = together(films, [each for each in found if each is not None])
    lean_deg = data.lean_before_deg[:, good]
    return Filmed(
        films=films,
        tracks=with_lean([_widened(each, wider) for each in tracks], *lean_deg),
        lean_deg=lean_deg,
        number=data.drop[data.begins[:-1]][good],
        pixel_m=pixel,
        floor_known=films[0].floor_known,
        sigma_y_m=sigma,
        sigma_known=declared or count > MANY,
        warnings=(
            *warnings,
            *doubts_of_lean(data.lean_before_deg[0]),
            *_of_noise(declared, scatter, count, memory, (sigma, pixel)),
        ),
        left_aside=_left_aside(data, found, bounces, len(straying)),
    )


def _over_a_surface(
    films: list[Film], bounces: int
) -> tuple[list[Film], list[Track | None], list[str]]:
    """The films, with a surface that may be anywhere where it is not at the declared zero, their
    tracks, and a warning where that is so."""
    found = [track(film, bounces) for film in films]
    if films[0].floor_known and _off(found):
        loose = [turned(film, 1) for film in films]
        again = [track(film, bounces) for film in loose]
        levels = [each.p[2] for each in again if each is not None and each.bounces]
        if levels and _usable(again) >= max(LEAST_DROPS, _usable(found)):
            return (
                loose,
                again,
                [
                    f"the surface seems to lie at {1e3 * float(np.median(levels)):.1f} mm, so the "
                    "zero of y_mm is taken to be anywhere, another in each film"
                ],
            )
    return films, found, []


def _is_off(scatter: float, count: int) -> bool:
    """Whether frames scatter by another variance than declared, beyond chance."""
    return bool(abs(scatter - 1.0) > BEYOND_CHANCE * np.sqrt(2.0 / count))


def _of_noise(
    declared: bool,
    scatter: float,
    count: int,
    memory: float,
    taken: tuple[float, float | None],
) -> list[str]:
    """What frames say of their own uncertainty beside what is declared; ``taken`` is that in m, and
    the length of a pixel."""
    sentences = []
    sigma, pixel = taken
    if not declared:
        size = f"{sigma / pixel:.3g} px" if pixel else f"{1e3 * sigma:.3g} mm"
        sentences.append(
            f"no uncertainty of a height is declared: {size} is taken, by which frames scatter "
            "about their own parabolas"
        )
    elif _is_off(scatter, count):
        sentences.append(
            f"frames scatter about their own parabolas by {np.sqrt(scatter):.2f} times the "
            "declared uncertainty"
            + (", and are taken to be as uncertain as that" if scatter > 1.0 else "")
        )
    if memory:
        sentences.append(
            f"errors of frames that follow each other are alike (correlation {memory:.2f}); rows "
            "are taken to be as uncertain as that makes them"
        )
    return sentences


def faster(film: Film, found: Track, fps: float) -> Track:
    """The same drop at a rate of ``fps``, as its track would have it."""
    t = np.arange(film.t_s[0], film.t_s[-1], 1.0 / fps)
    more = replace(film, t_s=t, y_m=np.interp(t, film.t_s, film.y_m), relative=1.0)
    phase, held = phases(more, found.p)
    predicted = heights(found.p, t, phase, film.gravity_m_s2)
    return reduced(replace(more, y_m=predicted), found.p, phase, held)


def _in_metres(data: Tracks) -> tuple[float | None, list[Film]]:
    """What a pixel is in m, where films are in pixels, and the films in m."""
    sigma = data.sigma_y_px if data.in_pixels else data.sigma_y_m
    gravity = data.manifest.gravity_m_s2
    pieces = data.pieces
    rough = _rough_sigma([data.value[piece] for piece in pieces])
    films = [
        Film(
            _since(data, piece),
            data.value[piece],
            sigma or rough,
            data.sigma_t_s,
            gravity,
            relative=data.relative[piece],
            # an error that several drops share does not become smaller in their mean
            sigma_floor_m=data.sigma_surface * float(np.sqrt(sharing)),
        )
        for piece, sharing in zip(pieces, data.sharing, strict=True)
    ]
    if not data.in_pixels:
        return None, films
    scale = pixel_m(films)
    if scale is None:
        raise InputError(
            f"{data.at(0)}: no gravity can be seen that half of the "
            "films share, so y_px has no scale; is t_s in s, and are there three frames or more "
            "in a fall?"
        )
    pixel, sign = scale
    of_mm = None if data.sigma_y_m is None else data.sigma_y_m / pixel
    made = [turned(film, sign) for film in films]
    return pixel, [
        replace(
            film,
            y_m=pixel * film.y_m,
            sigma_y_m=pixel * (data.sigma_y_px or of_mm or rough),
            sigma_floor_m=pixel * film.sigma_floor_m,
            floor_m=pixel * film.floor_m,
            floor_loose_m=pixel * film.floor_loose_m,
        )
        for film in made
    ]


def _since(data: Tracks, piece: slice) -> Array:
    """Times (frames,) since a film's first frame: clocks may count from long ago."""
    return data.t_s[piece] - data.t_s[piece][0]


def _rough_sigma(heights_of_films: Sequence[Array]) -> float:
    """About the deviation of a height, by third differences, which no parabola has."""
    thirds = np.concatenate([np.diff(y, 3) for y in heights_of_films])
    spread = max(float(np.ptp(y)) for y in heights_of_films)
    middle = float(np.median(np.abs(thirds))) / (0.6745 * np.sqrt(20.0))
    return min(max(middle, 1e-5 * spread, 1e-12), 0.02 * max(spread, 1e-9))


def _usable(found: Sequence[Track | None]) -> int:
    return sum(each is not None for each in found)


def _off(found: Sequence[Track | None]) -> bool:
    """Whether most films show no surface near the declared zero of heights."""
    levels = [abs(each.p[2]) for each in found if each is not None and each.bounces]
    return not levels or bool(np.median(levels) > MOST_OFF_M) or _usable(found) < len(found) / 2


def _straying(found: Sequence[Track | None]) -> set[int]:
    """Films whose frames scatter about their best track far more than others' do."""
    scatter = {i: t.misfit / t.freedom for i, t in enumerate(found) if t is not None}
    usual = float(np.median(list(scatter.values()))) if scatter else 0.0
    return {i for i, each in scatter.items() if each > STRAYING**2 * max(usual, 1.0)}


def _scatter(found: Sequence[Track | None]) -> tuple[float, int, float]:
    """Variance of frames about their best tracks over that assumed, how many say so, and the
    correlation of neighbours.

    The correlation is that of an autoregression, ρ, by the squares of differences one frame apart
    and two, which are as 1 − ρ and 1 − ρ²: a track takes up what is slow, and differences do not
    see that.
    """
    tracks = [each for each in found if each is not None]
    if not tracks:
        return 1.0, 1, 0.0
    misfit, freedom = sum(t.misfit for t in tracks), sum(t.freedom for t in tracks)
    pairs = np.array([t.pairs for t in tracks])
    one, two = pairs @ np.array([t.changes for t in tracks])
    if freedom < 1 or misfit <= 0.0 or one <= 0.0:
        return 1.0, 1, 0.0
    memory = float(np.clip(two / one - 1.0, 0.0, MOST_MEMORY))
    if memory < BEYOND_CHANCE / np.sqrt(pairs.sum()):
        return misfit / freedom, freedom, 0.0
    return float(one / (2.0 * (1.0 - memory) * pairs.sum())), freedom, memory


def _widened(found: Track, by: float) -> Track:
    return replace(
        found, values=found.values / by, weights=found.weights / by, known=found.known / by
    )


def _refusal(data: Tracks, films: Sequence[Film], found: Sequence[Track | None]) -> InputError:
    """Why too few films can be used, naming the first that cannot."""
    first = next(i for i, each in enumerate(found) if each is None)
    if not data.in_pixels:
        over = [track(turned(film, -1), 1) for film in films]
        if _usable(over) >= LEAST_DROPS > _usable(found):
            return InputError(
                f"{data.at(first)}: y_mm falls as the body rises; "
                "heights must count upward from the surface"
            )
    unit = "y_px" if data.in_pixels else "y_mm"
    return InputError(
        f"{data.at(first)}: {_usable(found)} of {len(found)} drops show "
        f"a fall unmistakably, that of drop {data.drop[data.begins[first]]} does not; the loop "
        f"needs {LEAST_DROPS} or more. Is t_s in s, and {unit} in {unit[2:]}?"
    )


def _left_aside(
    data: Tracks, found: Sequence[Track | None], bounces: int, straying: int
) -> tuple[str, ...]:
    """What of the films is not used, and why; ``straying`` of them follow no parabolas."""
    n, reasons = len(found), []
    tracks = [each for each in found if each is not None]
    falls = sum(not each.bounces for each in tracks)
    further = sum(_goes_on(data, i, each, bounces) for i, each in enumerate(found))
    mistaken = sum(each.mistaken for each in tracks)
    unseen = n - len(tracks) - straying
    if straying:
        reasons.append(
            f"{straying} of {n} drops lie {STRAYING:.0f} times farther from any parabolas than "
            "others do, and are not used"
        )
    if unseen:
        reasons.append(f"{unseen} of {n} drops do not show a fall unmistakably, and are not used")
    if falls:
        reasons.append(f"{falls} of {n} drops show no bounce, and serve the fall alone")
    if further:
        reasons.append(
            f"{further} of {n} drops go on after the second impact, which is not used: a bristle "
            "that has bounced rings and may lean"
        )
    if mistaken:
        reasons.append(
            f"{mistaken} of {len(data.value)} frames lie farther from their films' parabolas than "
            "scatter takes them, and are not used"
        )
    return tuple(reasons)


def _goes_on(data: Tracks, film: int, found: Track | None, bounces: int) -> bool:
    """Whether a film has frames after the last bounce that is used."""
    if found is None or bounces > 1 or not found.bounces:
        return False
    end = rises_of(found.p, data.manifest.gravity_m_s2)[-1, 6]
    return bool((_since(data, data.pieces[film]) > end).sum() > 1)
