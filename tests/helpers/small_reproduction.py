"""Studies that stand for the whole reproduction, and take seconds."""

from __future__ import annotations

from loop_toys import problem
from once import once

from bristle.studies.data.datasets import Drops
from bristle.studies.inputs.config import DropInputs
from bristle.studies.loop.problem import Problem
from bristle.studies.reproduce.campaign import Setup
from bristle.studies.reproduce.discretisation import (
    CrossCheck,
    ElementStudy,
    Enforcements,
    StepStudy,
)
from bristle.studies.reproduce.dragged import Dragged
from bristle.studies.reproduce.impact import Figure9, PeakTime
from bristle.studies.reproduce.leaning import Bars, Leaning, Sticking
from bristle.studies.reproduce.loop_section import LoopOnMeasured, LoopOnPaper
from bristle.studies.reproduce.rebound import Figure13, Figures10To12, KnStudy
from bristle.studies.reproduce.run import run_reproduce

GRID = (1e3, 1e4, 1e5, 3e5, 1e6, 2e6, 4e6, 1e7, 1e8, 1e9, 1e10)


def toy(drops: Drops) -> Problem:
    """As many drops with a slope that differs by chance, whatever ``drops`` are."""
    return problem(3, {"slope": 8.0}, drops=len(drops.drop), candidates=("drag", "slope"))[0]


def small() -> tuple[Setup, list]:
    """A coarse solid, few stiffnesses, one height."""
    base = DropInputs(cells=(1, 1, 60))
    kn = (1e4, 2e6, 1e8)
    setup = Setup(base, kn, (0.01, 0.05), (0.05,), (2e6,))
    return setup, [
        Figure9(setup),
        Figures10To12(setup, GRID),
        KnStudy(setup, GRID),
        Figure13(setup),
        CrossCheck(setup),
        Enforcements(setup),
        ElementStudy(setup, (2, 8, 16), 24),
        StepStudy(setup, 200),
        PeakTime(setup, (1e4, 1e6, 1e8)),
        Leaning(setup, (0.0, 2.0)),
        Sticking(setup, (4, 8), (1e-5, 5e-6), ((1, 1, 20), (1, 1, 40)), (3, 5)),
        Bars(setup, (0.1, 0.2), (0.0, 20.0)),
        Dragged((1, 1, 40), 2e-4),
        LoopOnPaper(1, toy),
        LoopOnMeasured(),
    ]


def reproduced(factory):
    """The folder of the small reproduction, made once for all tests, and what it found."""
    return once(factory, "reproduce", lambda folder: run_reproduce(folder, *small()))
