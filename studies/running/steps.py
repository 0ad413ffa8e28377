"""Steps of a march: how many contact takes, how far it is, and shorter ones where it fails."""

from __future__ import annotations

import math
from collections.abc import Callable

from ...solver.analytic import quarter_period_s
from ...solver.arrays import Array
from ...solver.batch import SHORTER
from ...solver.bristle import Bristle
from ...solver.checkpoint import Mark
from ...solver.contact_phase import Observer
from ...solver.errors import ComputationError
from ...solver.time.march import Moving


def steps_of_contact(bristle: Bristle, kn_N_m: float, its_s: float) -> int:
    """About how many steps contact takes, upright.

    A rigid bristle on the spring takes half a period, 2 (tp - ti) of Eq. 8; an elastic one on a
    rigid plane that of a wave up and down. The root of their squares is right at either end.
    """
    spring = 2.0 * quarter_period_s(bristle.mass_kg, kn_N_m) if math.isfinite(kn_N_m) else 0.0
    return math.ceil(math.hypot(spring, bristle.axial_period_s) / its_s)


def with_shorter_its[Found](run: Callable[[float], Found], its_s: float) -> Found:
    """What ``run`` gives at ``its_s`` or, where it fails there, at the longest part that serves.

    Raises the ComputationError of the shortest.
    """
    *longer, shortest = (part * its_s for part in (1.0, *SHORTER))
    for its in longer:
        try:
            return run(its)
        except ComputationError:
            continue
    return run(shortest)


class Watched:
    """An observer of ``simulate`` that tells of every step, around others or none.

    ``advance`` is called with the number of steps since it was last called.
    """

    def __init__(self, its_s: float, advance: Callable[..., None], *inner: Observer) -> None:
        self._its_s, self._advance, self._inner = its_s, advance, inner
        self._began_s, self._told = math.nan, 0

    def __call__(self, state: Moving, step_force: Array) -> None:
        if math.isnan(self._began_s):
            self._began_s = state.t_s
        self._tell(state)
        for each in self._inner:
            each(state, step_force)

    def memory(self) -> dict[str, Array]:
        """What the inner ones need to go on: counting starts anew."""
        return {name: each for inner in self._inner for name, each in inner.memory().items()}

    def recall(self, mark: Mark, state: Moving) -> None:
        """Go on after the steps that were kept."""
        self._began_s = state.t_s - mark.steps * self._its_s
        self._tell(state)
        for each in self._inner:
            each.recall(mark, state)

    def _tell(self, state: Moving) -> None:
        done = round((state.t_s - self._began_s) / self._its_s)
        if done > self._told:
            self._advance(done - self._told)
            self._told = done
