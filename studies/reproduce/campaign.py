"""Cases of many page sections, each computed once, spread over the ranks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ...solver import paper
from ...solver.drop import DropResult
from ..inputs.choices import Contact, Model, Tip
from ..inputs.config import DropInputs
from ..inputs.fields import FLAT
from ..inputs.stance import ANGLES
from ..report.page import Section
from ..running.cases import Workshop
from ..running.groups import run_solids
from ..running.parallel import share_out

Results = Mapping[DropInputs, DropResult]
Tick = Callable[[], None]


@dataclass(frozen=True)
class Setup:
    """What the studies of one reproduction share.

    ``base`` has the bristle, the discretisations and ITS; ``full_kn_N_m`` are the stiffnesses for
    which the full-order solid runs at ``top_m``, the height at which studies need only one.
    """

    base: DropInputs
    kn_N_m: tuple[float, ...] = paper.KN_N_M
    heights_m: tuple[float, ...] = paper.HEIGHTS_M
    fig9_heights_m: tuple[float, ...] = paper.FIG9_HEIGHTS_M
    full_kn_N_m: tuple[float, ...] = paper.KN_N_M
    chosen_N_m: float = paper.KN_CHOSEN_N_M

    @property
    def top_m(self) -> float:
        return max(self.heights_m)

    @property
    def its_s(self) -> float:
        return self.base.its_s

    @property
    def ends_N_m(self) -> tuple[float, ...]:
        """The softest, the chosen and the stiffest contact."""
        return tuple(dict.fromkeys((min(self.kn_N_m), self.chosen_N_m, max(self.kn_N_m))))

    def case(
        self, model: str, kn_N_m: float, height_m: float | None = None, **changes: Any
    ) -> DropInputs:
        """One drop; the beam touches with the node on its axis, as in the paper."""
        tip = Tip.POINT if model == Model.BEAM else Tip.FACE
        values = {"model": model, "kn_N_m": float(kn_N_m), "tip": tip, **changes}
        return self.base.changed(height_m=height_m or self.top_m, **values)


class Study(Protocol):
    """A section of the report: which drops it needs, and what it says of them."""

    def cases(self) -> list[DropInputs]:
        """Every drop that ``section`` will look up."""
        ...

    def section(self, results: Results) -> Section:
        """The section with its figures and tables."""
        ...


def compute(
    cases: Iterable[DropInputs],
    workshop: Workshop,
    tick: Tick = lambda: None,
    ranks_per_case: int | None = None,
) -> dict[DropInputs, DropResult]:
    """Every different case once; all results on rank 0, which calls ``tick`` after each.

    Bodies in modes run on one rank each, the full-order solid on groups of ranks
    (`groups.run_solids`). Collective; a ComputationError is raised on every rank.
    """
    distinct = list(dict.fromkeys(cases))
    solid = [case for case in distinct if case.model is Model.SOLID]
    modal = [case for case in distinct if case.model is not Model.SOLID]
    results: dict[DropInputs, DropResult] = {}

    def taking(those: Sequence[DropInputs]) -> Callable[[int, DropResult], None]:
        def take(i: int, result: DropResult) -> None:
            results[those[i]] = result
            tick()

        return take

    run_solids(workshop, solid, lambda own, case: own.run(case)[0], taking(solid), ranks_per_case)
    for first in dict.fromkeys(_built(case, workshop.basis_its_s) for case in modal):
        if first is not None:
            workshop.prepare(first)
    share_out(workshop.comm, len(modal), lambda i: workshop.run(modal[i])[0], taking(modal))
    return results


def _built(case: DropInputs, basis_its_s: float | None) -> DropInputs | None:
    """The plainest case with the same body, where all ranks must build that together.

    How far it leans makes no other body, only that it does; nor does its ITS where
    ``basis_its_s`` serves all.
    """
    if case.model is not Model.REDUCED:
        return None
    upright = dict.fromkeys(ANGLES, 0.0) | {"tip_shape": FLAT}
    return case.changed(
        **upright | ({"tilt_deg": 1.0} if case.leaning else {}),
        friction=paper.FRICTION,
        kt_ratio=None,
        kn_N_m=paper.KN_CHOSEN_N_M,
        height_m=paper.HEIGHTS_M[-1],
        its_s=basis_its_s or case.its_s,
        contact=Contact.NITSCHE if case.contact is Contact.NITSCHE else Contact.PENALTY,
        theta=None,
        gamma0=None,
    )
