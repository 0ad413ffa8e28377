"""Linearisation of films about features estimated from all films together.

Rows are linear about a track. A film's own best track has the features that it hardly tells wrong
by so much that the rows of the others, which it tells well, are off by a part of their noise, and
all films' by the same. What films have in common they tell together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .....solver.arrays import Array
from .flight import BOUNCE, HEAD, heightened
from .rows import FEATURES, LOOSE, Film, Track, names_of
from .search import settled_about

NEAR = 0.03
"""How near, as a share of `LOOSE`, the features of one film are to those of all where films agree:
what they tell together is about as sure."""


def together(films: Sequence[Film], tracks: Sequence[Track]) -> list[Track]:
    """The films' tracks once more, about the features that all films together tell.

    Common to all are z, h, b, a, d, drag over mass and the speed at release, which both add to h;
    each drop has its own r.
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
    """Features (drops, features) by least squares over all rows, ``per_drag_m`` (drops,) being u
    over drag over mass; and by how much, over its noise, the rows leave them."""
    drops, n = len(per_drag_m), 7
    slow = per_drag_m.min() / per_drag_m
    loose = [LOOSE[name] for name in "zhbad"] + [LOOSE["u"] / per_drag_m.max(), LOOSE["h"]]
    tight = np.diag(1.0 / np.concatenate([loose, np.full(drops, 10.0)]))
    by = np.zeros((drops, len(FEATURES), n + drops))
    for k, name in enumerate("zhbad"):
        by[:, FEATURES.index(name), k] = 1.0
    by[:, FEATURES.index("u"), 5] = per_drag_m
    by[:, FEATURES.index("h"), 6] = slow
    by[np.arange(drops), FEATURES.index("r"), n + np.arange(drops)] = 1.0
    values = np.concatenate([each.values for each in tracks])
    bent: Array = np.full(drops, 0.5)
    solution: Array = np.zeros(n + drops)
    for _ in range(3):
        by[:, FEATURES.index("h"), 5] = bent * per_drag_m
        parts, i = [], 0
        for each in tracks:
            end = i + len(each.speed_m_s)
            parts.append(each.weights @ by[i:end].reshape(-1, n + drops))
            i = end
        design = np.vstack([*parts, tight])
        solution = np.linalg.lstsq(design, np.pad(values, (0, len(tight))), rcond=None)[0]
        drag = by[:, FEATURES.index("u")] @ solution
        bent = np.array([(heightened(u) - 1.0) / u if abs(u) > 1e-6 else 0.5 for u in drag])
    residual = values - design[: len(values)] @ solution
    apart = float(residual @ residual) / max(len(values) - len(solution), 1)
    return by @ solution, float(np.sqrt(max(apart, 1.0)))
