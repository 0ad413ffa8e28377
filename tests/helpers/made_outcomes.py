"""Made-up outcomes of benchmarks, for tests of what is told of them."""

from __future__ import annotations

from benchmarks import ranks, sizes, step
from benchmarks.communication import Machine
from benchmarks.peers_points import Converged, Point, Run, converged, points
from benchmarks.programs import DAMPED, PROGRAMS, QUANTITIES, UNDAMPED, Answer, Setting

ITS_S = (2e-5, 1e-5, 5e-6)
NEAR = {"rebound_ratio": 0.65, "contact_time_s": 1.6e-4, "peak_force_N": 40.0}


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


def steps() -> list[step.Line]:
    """Two bodies: the larger takes twice as long."""
    return [
        step.Line(
            cells=cells,
            order=2,
            unknowns=10_000 * times,
            ranks=1,
            repeats=3,
            method="direct",
            factor_entries=1_000_000 * times,
            read_GB_s=20.0,
            triad_GB_s=15.0,
            read_ms=4.0 * times,
            solve_ms=9.0 * times,
            mass_ms=1.0 * times,
            step_ms=10.0 * times,
            contact_step_ms=12.0 * times,
            over_read=2.25,
            step_over_solve=1.11,
            contact_step_over_solve=1.33,
        )
        for times, cells in ((1, "1 4 62"), (2, "1 4 124"))
    ]


def growing() -> list[sizes.Line]:
    """Times and memory of a slender bar that grow as its unknowns, of a cube faster."""
    powers = {("along", "direct"): 1.0, ("compact", "direct"): 4.0 / 3.0}
    return [
        sizes.Line(
            series=series,
            cells=f"1 4 {n // 200}",
            order=2,
            unknowns=n,
            ranks=1,
            repeats=5,
            method=method,
            mesh_s=1e-6 * n,
            assemble_s=1e-5 * n,
            factor_s=1e-5 * n**power,
            step_s=1e-7 * n**power,
            iterations=None,
            bytes_per_unknown=2000.0,
            peak_MB=100.0 + 1e-3 * n,
        )
        for (series, method), power in powers.items()
        for n in (50_000, 100_000, 200_000)
    ]


def shared_out() -> tuple[list[ranks.Line], Machine, ranks.Memory]:
    """Jobs on one rank and two that lose a tenth, and a machine whose memory allows 90 %."""
    memory = ranks.Memory(
        ranks=2, memory_B_s=9e9, memory_alone_B_s=1.2e10, solve_B_s=9e9, solve_alone_B_s=1e10
    )
    todo = ranks.jobs(2)
    times = {job: [{"total_s": 10.0 / job.base.ranks, "march_s": 8.0}] for job in todo}
    for job in todo:
        if job != job.base:
            times[job] = [
                {name: value / job.ideal / 0.9 for name, value in times[job.base][0].items()}
            ]
    machine = Machine(latency_s=1e-6, bandwidth_B_s=5e9, memory_B_s=9e9, solve_B_s=9e9)
    return list(ranks._lines(times, 2, memory)), machine, memory
