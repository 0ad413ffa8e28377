"""Cases of many page sections, each computed once, spread over the ranks, and the frame of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from mpi4py import MPI

from ...solver import paper
from ...solver.analytic import analytic_drop
from ...solver.drop import DropResult
from ..inputs.choices import Model, Tip
from ..inputs.config import DropInputs
from ..report.figures import LOOKS
from ..report.page import Section
from ..report.prose import Prose
from ..running.cases import CaseSession
from ..running.groups import build_reduced, run_cases

Results = Mapping[DropInputs, DropResult]
Tick = Callable[[], None]
# What a plan says of a case beside its inputs.
Labels = dict[str, Any]

# The words of all sections.
prose = Prose(Path(__file__).with_name("words.j2"))
# An error that is small enough.
GOAL = 0.01
# What models and discretisations are compared in, and its name in words.
QUANTITIES = {
    "rebound_ratio": "y1/y0",
    "contact_time_us": "contact time",
    "peak_force_N": "peak force",
    "max_penetration_um": "penetration",
}
# The models that have a body.
BODIES = ("beam", "reduced", "solid")
# So stiff that y1/y0 has reached the limit of a rigid plane to about 10⁻³; the few modes of the
# reduced solid follow the shorter waves of a yet stiffer contact no longer.
RIGID_N_M = {"beam": 1e10, "reduced": 1e9}
RIGID_ITS_S = 1e-7


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

    def rigid(self, model: str, **changes: Any) -> DropInputs:
        """One drop onto what is as good as a rigid plane."""
        return self.case(model, RIGID_N_M[model], its_s=RIGID_ITS_S, **changes)

    def analytic(self, kn_N_m: float) -> DropResult:
        """Eqs. 1 to 8 at the top height."""
        base = self.base
        return analytic_drop(base.bristle().mass_kg, kn_N_m, self.top_m, base.gravity_m_s2)

    @property
    def axial_N_m(self) -> float:
        """E A / L of the bristle."""
        bristle = self.base.bristle()
        return bristle.material.youngs_Pa * bristle.section.area_m2 / bristle.length_m


class Study(ABC):
    """A section of the report: which drops it needs, and what it says of them."""

    def cases(self) -> list[DropInputs]:
        """Every drop that ``section`` will look up; none, unless a section says otherwise."""
        return []

    def prepare(self, comm: MPI.Intracomm) -> None:
        """Compute before ``section`` what it needs beside drops, if anything; collective."""
        return

    @abstractmethod
    def section(self, results: Results) -> Section:
        """The section with its figures and tables."""


@dataclass(frozen=True)
class DropStudy(Study):
    """A section on drops, each of its ``plan``, which it sees as the rows of a frame."""

    setup: Setup

    @abstractmethod
    def plan(self) -> Iterator[tuple[DropInputs, Labels]]:
        """The cases of the section's tables, and columns of their rows that inputs do not tell."""

    def cases(self) -> list[DropInputs]:
        return [case for case, _ in self.plan()]

    def drops(self, results: Results) -> pd.DataFrame:
        """A row a case, in the order of the plan: `record` and the labels."""
        return pd.DataFrame(record(case, results[case]) | labels for case, labels in self.plan())


def record(case: DropInputs, result: DropResult) -> dict[str, Any]:
    """What tables and figures show of a drop, in the units in which they do."""
    energy = result.energy
    return {
        "model": case.model.value,
        "kn_MN_m": case.kn_N_m / 1e6,
        "y0_mm": 1e3 * case.height_m,
        "its_ms": 1e3 * case.its_s,
        "beta_s": case.beta_s,
        "lean_deg": case.tilt_deg,
        "mu": case.friction,
        "rebound_ratio": result.rebound_ratio,
        "contact_time_us": 1e6 * result.contact_time_s,
        "peak_force_N": result.peak_force_N,
        "max_penetration_um": 1e6 * result.max_penetration_m,
        "tp_us": 1e6 * result.time_to_max_penetration_s,
        "touches": result.n_contacts,
        "energy_closure": energy.closure_relative,
        # upward speed of the centre of mass after the impact over the speed of the impact
        "kept": result.cm_velocity_after_m_s / result.impact_speed_m_s,
        "friction_loss": energy.friction_loss_J / energy.initial_J,
        "impulse_ratio": result.friction_impulse_N_s / result.impulse_N_s,
    }


def named(model: pd.Series) -> pd.Series:
    """Models as tables call them."""
    return model.map({name: look.label.partition(",")[0] for name, look in LOOKS.items()})


def compute(
    cases: Iterable[DropInputs],
    session: CaseSession,
    tick: Tick = lambda: None,
    ranks_per_case: int | None = None,
) -> dict[DropInputs, DropResult]:
    """Every different case once; all results on rank 0, which calls ``tick`` after each.

    See `groups.run_cases`. Collective; a ComputationError is raised on every rank.
    """
    # results of the full-order solid come first, as the page has their warnings
    distinct = sorted(dict.fromkeys(cases), key=lambda case: case.model is not Model.SOLID)
    results: dict[DropInputs, DropResult] = {}

    def take(i: int, result: DropResult) -> None:
        results[distinct[i]] = result
        tick()

    build_reduced(session, distinct)
    run_cases(session, distinct, lambda own, case: own.run(case)[0], take, ranks_per_case)
    return {case: results[case] for case in distinct if case in results}
