"""The films of a dataset as tracks: which can be used, in which unit, and how frames scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...solver.bristle import Array
from ...solver.errors import InputError
from .track_flight import BOUNCE, HEAD, heightened, heights, rises_of
from .track_rows import FEATURES, LOOSE, Film, Track, names_of, reduced
from .track_scale import pixel_m, turned
from .track_search import phases, settled_about, track
from .tracks_record import LEAST_FILMS, Tracks

FASTER_FPS, FASTER = 250.0, 4.0
MOST_OFF_M = 5e-3
"""How far the surface may be from a declared zero of the heights: what an eye would not see."""
BEYOND_CHANCE = 4.0
"""Standard errors beyond which the scatter of frames is another than declared."""
MOST_BOUNCES = 8
NEAR = 0.03
"""How near, as a share of `LOOSE`, the features of one film are to those of all where films agree:
what they tell together is about as sure."""


@dataclass(frozen=True)
class Filmed:
    """The films that can be used, their tracks and numbers; what a pixel is in m, for films in
    pixels, and what the user is to know of the rest."""

    films: Sequence[Film]
    tracks: Sequence[Track]
    number: NDArray[np.int64]
    pixel_m: float | None
    floor_known: bool
    sigma_y_m: float
    sigma_declared: bool
    warnings: tuple[str, ...]
    left_aside: tuple[str, ...]

    @property
    def faster_fps(self) -> float:
        """A rate worth filming at next."""
        frame = np.median([np.median(np.diff(film.t_s)) for film in self.films])
        return max(FASTER_FPS, float(f"{FASTER / frame:.2g}"))


def filmed(data: Tracks) -> Filmed:
    """The films of a dataset. Raises InputError where too few can be used."""
    pixel, films = _in_metres(data)
    warnings: list[str] = []
    bounces = MOST_BOUNCES if _bounces_upright(data) else 1
    found, known = [track(film, bounces) for film in films], pixel is None
    if pixel is None and _off(found):
        loose = [turned(film, 1) for film in films]
        again = [track(film, bounces) for film in loose]
        if _usable(again) >= max(LEAST_FILMS, _usable(found)):
            films, found, known = loose, again, False
            level = 1e3 * float(np.median([each.p[2] for each in again if each and each.bounces]))
            warnings.append(
                f"the surface seems to lie at {level:.1f} mm, so the zero of y_mm is taken to be "
                "anywhere, another in each film"
            )
    if _usable(found) < LEAST_FILMS:
        raise _refusal(data, films, found)
    sigma, declared = films[0].sigma_y_m, _declared(data)
    scatter, count, memory = _scatter(found)
    if not declared:
        for _ in range(2):
            films = [replace(film, sigma_y_m=film.sigma_y_m * np.sqrt(scatter)) for film in films]
            found = [track(film, bounces) for film in films]
            if _usable(found) < LEAST_FILMS:
                raise _refusal(data, films, found)
            scatter, count, memory = _scatter(found)
        sigma = films[0].sigma_y_m
    wider = 1.0
    if declared and abs(scatter - 1.0) > BEYOND_CHANCE * np.sqrt(2.0 / count):
        warnings.append(
            f"frames scatter about their own parabolas by {np.sqrt(scatter):.2f} times the "
            "declared uncertainty"
            + (", and are taken to be as uncertain as that" if scatter > 1.0 else "")
        )
        wider = max(scatter, 1.0)
    if memory > BEYOND_CHANCE / np.sqrt(count):
        warnings.append(
            f"errors of frames that follow each other are alike (correlation {memory:.2f}); rows "
            "are taken to be as uncertain as that makes them"
        )
        wider *= (1.0 + memory) / (1.0 - memory)
    good = [i for i, each in enumerate(found) if each is not None]
    films = [films[i] for i in good]
    tracks = together(films, [each for each in found if each is not None])
    return Filmed(
        films=films,
        tracks=[_widened(each, np.sqrt(wider)) for each in tracks],
        number=data.drop[data.begins[:-1]][good],
        pixel_m=pixel,
        floor_known=known,
        sigma_y_m=sigma,
        sigma_declared=declared,
        warnings=tuple(warnings),
        left_aside=_left_aside(data, found, bounces),
    )


def together(films: Sequence[Film], tracks: Sequence[Track]) -> list[Track]:
    """The films' tracks once more, about the features that all films together tell.

    Common to all are z, h, b, a, d and drag over mass, which adds to h; each drop has its own r.
    """
    g = films[0].gravity_m_s2
    speed = np.concatenate([each.speed_m_s for each in tracks])
    features, apart = _common_features(tracks, speed**2 / g)
    again, i = [], 0
    for film, each in zip(films, tracks, strict=True):
        centre, loose = each.p.copy(), np.full(len(each.p), np.inf)
        for k, name in enumerate(names_of(each.p)):
            told = name == "z" and not (film.floor_known and each.bounces)
            if name in LOOSE and name != "r" and not told:
                drop = i + max(k - len(HEAD), 0) // len(BOUNCE)
                centre[k] = features[drop, FEATURES.index(name)]
                loose[k] = min(NEAR * apart, 1.0) * LOOSE[name]
        again.append(settled_about(film, each, centre, loose))
        i += len(each.speed_m_s)
    return again


def _common_features(tracks: Sequence[Track], per_drag_m: Array) -> tuple[Array, float]:
    """Features (drops, 7) by least squares over all rows, ``per_drag_m`` (drops,) being u over drag
    over mass; and by how much, over its noise, the rows leave them."""
    drops = len(per_drag_m)
    loose = np.array([LOOSE[name] for name in "zhbad"] + [LOOSE["u"] / per_drag_m.max()])
    tight = np.diag(1.0 / np.concatenate([loose, np.full(drops, 10.0)]))
    by = np.zeros((drops, len(FEATURES), 6 + drops))
    for k, name in enumerate("zhbad"):
        by[:, FEATURES.index(name), k] = 1.0
    by[:, FEATURES.index("u"), 5] = per_drag_m
    by[np.arange(drops), FEATURES.index("r"), 6 + np.arange(drops)] = 1.0
    values = np.concatenate([each.values for each in tracks])
    bent: Array = np.full(drops, 0.5)
    said: Array = np.zeros(6 + drops)
    for _ in range(3):
        by[:, FEATURES.index("h"), 5] = bent * per_drag_m
        parts, i = [], 0
        for each in tracks:
            n = len(each.speed_m_s)
            parts.append(each.weights @ by[i : i + n].reshape(-1, 6 + drops))
            i += n
        design = np.vstack([*parts, tight])
        said = np.linalg.lstsq(design, np.pad(values, (0, len(tight))), rcond=None)[0]
        drag = by[:, FEATURES.index("u")] @ said
        bent = np.array([(heightened(u) - 1.0) / u if abs(u) > 1e-6 else 0.5 for u in drag])
    left = values - design[: len(values)] @ said
    apart = float(left @ left) / max(len(values) - len(said), 1)
    return by @ said, float(np.sqrt(max(apart, 1.0)))


def faster(film: Film, found: Track) -> Track:
    """The same drop with `FASTER` times as many frames, as its track would have them."""
    n = int(FASTER * len(film.t_s))
    t = np.linspace(film.t_s[0], film.t_s[-1], n)
    more = replace(film, t_s=t, y_m=np.interp(t, film.t_s, film.y_m))
    phase, held = phases(more, found.p)
    seen = heights(found.p, t, phase, film.gravity_m_s2)
    return reduced(replace(more, y_m=seen), found.p, phase, held)


def _bounces_upright(data: Tracks) -> bool:
    """Whether a body bounces again as it did first: a ball does, a bristle rings and leans."""
    return getattr(data.manifest, "shape", "bristle") == "rigid"


def _declared(data: Tracks) -> bool:
    return data.sigma_y_m is not None or (data.in_pixels and data.sigma_y_px is not None)


def _in_metres(data: Tracks) -> tuple[float | None, list[Film]]:
    """What a pixel is in m, where films are in pixels, and the films in m."""
    sigma = data.sigma_y_px if data.in_pixels else data.sigma_y_m
    gravity = data.manifest.gravity_m_s2
    pieces = data.pieces
    rough = _rough_sigma([data.y[piece] for piece in pieces])
    films = [
        Film(data.t_s[piece], data.y[piece], sigma or rough, data.sigma_t_s, gravity)
        for piece in pieces
    ]
    if not data.in_pixels:
        return None, films
    scale = pixel_m(films)
    if scale is None:
        raise InputError(
            f"{data.manifest.table()}:{data.line[0]}: no gravity can be seen that half of the "
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
            floor_m=pixel * film.floor_m,
            floor_loose_m=pixel * film.floor_loose_m,
        )
        for film in made
    ]


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


def _scatter(found: Sequence[Track | None]) -> tuple[float, int, float]:
    """Variance of frames about their best tracks over that assumed, how many say so, and the
    correlation of neighbours."""
    tracks = [each for each in found if each is not None]
    misfit, freedom = (sum(getattr(t, name) for t in tracks) for name in ("misfit", "freedom"))
    if freedom < 1 or misfit <= 0.0:
        return 1.0, 1, 0.0
    return misfit / freedom, freedom, sum(t.neighbours for t in tracks) / misfit


def _widened(found: Track, by: float) -> Track:
    return replace(
        found, values=found.values / by, weights=found.weights / by, known=found.known / by
    )


def _refusal(data: Tracks, films: Sequence[Film], found: Sequence[Track | None]) -> InputError:
    """Why too few films can be used, naming the first that cannot."""
    first = next(i for i, each in enumerate(found) if each is None)
    if not data.in_pixels:
        over = [track(turned(film, -1), 1) for film in films]
        if _usable(over) >= LEAST_FILMS > _usable(found):
            return InputError(
                f"{data.manifest.table()}:{data.line[first]}: y_mm falls as the body rises; "
                "heights must count upward from the surface"
            )
    unit = "y_px" if data.in_pixels else "y_mm"
    return InputError(
        f"{data.manifest.table()}:{data.line[first]}: {_usable(found)} of {len(found)} films show "
        f"a fall unmistakably, that of drop {data.drop[data.begins[first]]} does not; the loop "
        f"needs {LEAST_FILMS} or more. Is t_s in s, and {unit} in {unit[2:]}?"
    )


def _left_aside(data: Tracks, found: Sequence[Track | None], bounces: int) -> tuple[str, ...]:
    """What of the films is not used, and why."""
    n, said = len(found), []
    tracks = [each for each in found if each is not None]
    falls = sum(not each.bounces for each in tracks)
    further = sum(_goes_on(data, i, each, bounces) for i, each in enumerate(found))
    mistaken = sum(each.mistaken for each in tracks)
    if len(tracks) < n:
        said.append(
            f"{n - len(tracks)} of {n} films do not show a fall unmistakably, and are not used"
        )
    if falls:
        said.append(f"{falls} of {n} films show no bounce, and serve the fall alone")
    if further:
        said.append(
            f"{further} of {n} films go on after the second impact, which is not used: a bristle "
            "that has bounced rings and may lean"
        )
    if mistaken:
        said.append(
            f"{mistaken} of {len(data.y)} frames lie farther from their films' parabolas than "
            "scatter takes them, and are not used"
        )
    return tuple(said)


def _goes_on(data: Tracks, film: int, found: Track | None, bounces: int) -> bool:
    """Whether a film has frames after the last bounce that is used."""
    if found is None or bounces > 1 or not found.bounces:
        return False
    end = rises_of(found.p, data.manifest.gravity_m_s2)[-1, 6]
    return bool((data.t_s[data.pieces[film]] > end).sum() > 1)
