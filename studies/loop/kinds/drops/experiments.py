"""Measurements that could be made next of drops, and what models predict of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ...problem import Experiment
from ...responses.drop_model import DropModel, Drops

# What is within reach: an electrical contact's timing, a piezo-electric cell under the plate, a
# ruler in the film's plane read to a tenth of a millimetre.
CONTACT_TIME_S = 1e-6
FORCE_N = 0.5
HEIGHT_M = 1e-4

Build = Callable[[Drops, Mapping[int, float], tuple[str, ...]], DropModel]


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
        (1, CONTACT_TIME_S, "measure the contact time as well, to 1 µs, in as many drops"),
        (2, FORCE_N, "measure the peak force as well, to 0.5 N, in as many drops"),
    ):
        if q not in drops.quantities:
            more = tuple(sorted((*drops.quantities, q)))
            out.append(one(words, replace(drops, quantities=more), {q: sigma}))
    if sigmas[0] > 1.5 * HEIGHT_M:
        out.append(one("read the heights to 0.1 mm, in as many drops", drops, {0: HEIGHT_M}))
    low, high = float(drops.y0_m.min()), float(drops.y0_m.max())
    ends = np.where(np.arange(len(drops)) % 2 == 0, low, high)
    words = f"make as many drops again, half from {1e3 * low:.0f} mm, half from {1e3 * high:.0f} mm"
    out.append(one(words, replace(drops, y0_m=ends), {}))
    return out
