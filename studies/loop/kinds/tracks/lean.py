"""The lean that a film shows before its first impact, as a row of that film.

Only the plane of the picture shows. What is seen there is taken for the whole lean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .....solver.arrays import Array
from ....data.tables import LEAST_DROPS
from .rows import FEATURES, Track

COMMON_DEG = 0.1
"""By how much the camera's roll and its lens may turn the leans of all films alike."""
LEAST_LEAN_DEG = 0.3
"""Half a degree takes 2 % off the rebound of a bristle with little damping."""


def with_lean(tracks: Sequence[Track], lean_deg: Array, sigma_deg: Array) -> list[Track]:
    """The tracks with a row for the size of the lean of each film that shows one.

    ``lean_deg`` and its standard error ``sigma_deg`` (films,) are not a number where none is seen.
    Bristles do not lean alike in all films: by how much their leans differ is part of the error.
    """
    seen = np.isfinite(lean_deg)
    if not seen.any():
        return list(tracks)
    # an error in any direction makes a lean look larger
    square = lean_deg**2 - sigma_deg**2 - COMMON_DEG**2
    size = np.sqrt(np.maximum(square, 0.0))
    differ = 1.4826 * float(np.median(np.abs(size[seen] - np.median(size[seen]))))
    # what all films have in common does not become smaller in their mean
    sigma = np.sqrt(sigma_deg**2 + differ**2 + seen.sum() * COMMON_DEG**2)
    return [
        _and_row(track, size[i] / sigma[i], 1.0 / sigma[i]) if seen[i] else track
        for i, track in enumerate(tracks)
    ]


def _and_row(track: Track, value: float, weight: float) -> Track:
    row = np.zeros((1, track.weights.shape[1]))
    row[0, FEATURES.index("l")] = weight
    return replace(
        track,
        values=np.append(track.values, value),
        weights=np.vstack([track.weights, row]),
        leading=np.append(track.leading, FEATURES.index("l")),
        drop=np.append(track.drop, 0),
        known=np.append(track.known, weight),
    )


def doubts_of_lean(lean_deg: Array) -> list[str]:
    """What films say of a lean before the impact, and what they cannot say."""
    seen = lean_deg[np.isfinite(lean_deg)]
    if len(seen) < LEAST_DROPS:
        return []
    middle = float(np.median(np.abs(seen)))
    if middle < LEAST_LEAN_DEG:
        return [
            f"the films show upright bristles (they lean by {middle:.2f} degrees, the median of "
            f"{len(seen)}); a lean towards the camera would not show, and is taken to be zero"
        ]
    return [
        f"the films show bristles that lean by {middle:.1f} degrees before the impact (median of "
        f"{len(seen)}, in the plane of the picture): a model that stands upright lacks that"
    ]
