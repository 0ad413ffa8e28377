"""What may benchmarks have measured, for tests of what is told of it? All is made up."""

from __future__ import annotations

from typing import Any

from bristle.studies.bench.loop_cases import ROWS
from bristle.studies.bench.peers_table import Converged, Point, Run, converged, points
from bristle.studies.bench.programs import DAMPED, PROGRAMS, QUANTITIES, UNDAMPED, Answer, Setting

ITS_S = (2e-5, 1e-5, 5e-6)
NEAR = {"rebound_ratio": 0.65, "contact_time_s": 1.6e-4, "peak_force_N": 40.0}


def outcome(row: str, number: int, **other: Any) -> dict[str, Any]:
    said = {
        "row": row,
        "number": number,
        "truth": ["adhesion"],
        "verdict": "effect",
        "effects": ["adhesion"],
        "same": ["adhesion"],
        "ideal": [1.0, 1.0],
        "classes": [],
        "covered": [True, False],
        "before": 2.0,
        "after": 1.1,
        "oracle": 1.0,
        "rivals": {"BIC": "adhesion"},
    }
    return said | other


def outcomes_of_every_row(datasets: int = 6) -> list[dict[str, Any]]:
    """Right but for the first of each row, with held-out errors that differ."""
    found = []
    for row in ROWS:
        right = "unknown" if row.unlisted else "effect" if row.listed else "adequate"
        for number in range(datasets):
            said = {"verdict": right, "effects": ["adhesion"] if right == "effect" else []}
            if number == 0:
                said = {"verdict": "effect", "effects": ["wear"]}
            errors = {"before": 2.0 + number, "after": 1.1 + 0.1 * number}
            found.append(outcome(row.name, number, **said, **errors))
    return found


def points_of_every_program() -> tuple[list[Point], dict[str, Converged], list[Run]]:
    """Each program at each ITS: an error of second order, a time that goes as the steps do."""
    to = {
        physics.name: converged(_found(1.0), _found(0.25), _found(0.0))
        for physics in (DAMPED, UNDAMPED)
    }
    runs = [
        Run(program.name, Setting(physics, (1, 2, 42), its_s), _answer(place, its_s))
        for physics in (DAMPED, UNDAMPED)
        for its_s in ITS_S
        for place, program in enumerate(PROGRAMS)
        if physics.name in program.physics
    ]
    return points(runs, to), to, runs


def _found(error: float) -> dict[str, float]:
    return {name: NEAR[name] * (1.0 + 0.01 * error) for name in QUANTITIES}


def _answer(place: int, its_s: float) -> Answer:
    scale = its_s / ITS_S[0]
    found = _found((1.0 + 0.2 * place) * scale**2) | {
        "n_steps": round(2e-4 / its_s),
        "n_dofs": 6885,
    }
    wall_s = (1.0 + place) / scale
    return Answer(found, wall_s=wall_s, further_s=0.1 * wall_s, peak_rss_MB=100.0)
