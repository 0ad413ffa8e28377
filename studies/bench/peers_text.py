"""How is the comparison of programs told on a terminal?"""

from __future__ import annotations

from collections.abc import Sequence

from .peers_table import LEVELS, Converged, Point, Reached, Run, blocks, by_program, reached
from .programs import PROGRAMS, QUANTITIES

HEAD = (
    f"{'':24}{'ITS':>9}{'steps':>7}{'y1/y0':>9}{'error':>10}{'contact':>10}{'error':>10}"
    f"{'peak':>8}{'error':>10}{'time':>9}{'further':>9}{'memory':>8}"
)
UNITS = f"{'':24}{'µs':>9}{'':26}{'µs':>10}{'':10}{'N':>8}{'':10}{'s':>9}{'s':>9}{'MB':>8}"


def told(found: Sequence[Point], to: dict[str, Converged], runs: Sequence[Run]) -> str:
    """The table: for each block every program at every ITS, then time at equal error."""
    lines = []
    for own in blocks(found):
        physics, cells = own[0].setting.physics, cells_words(own)
        lines += [f"{physics.name}: β = {physics.beta_s:g} s, {cells}", HEAD, UNITS]
        lines += [_line(point) for each in by_program(own).values() for point in each]
        lines += [_converged(to[physics.name]), *_reached(own), ""]
    return "\n".join([*lines, *absences(runs)])


def cells_words(own: Sequence[Point]) -> str:
    """The mesh of a block."""
    setting = own[0].setting
    unknowns = max(point.found["n_dofs"] for point in own if point.program != "bristle, beam")
    return f"{' × '.join(map(str, setting.cells))} cells, {unknowns:.0f} unknowns"


def _line(point: Point) -> str:
    ratio, contact, peak = (point.found[name] for name in QUANTITIES)
    errors = [_percent(point.errors[name]) for name in QUANTITIES]
    further = "–" if point.further_s is None else f"{point.further_s:.3g}"
    return (
        f"{point.program:24}{1e6 * point.setting.its_s:9.3g}{point.found['n_steps']:7.0f}"
        f"{ratio:9.5f}{errors[0]:>10}{1e6 * contact:10.3f}{errors[1]:>10}"
        f"{peak:8.3f}{errors[2]:>10}{point.wall_s:9.3g}{further:>9}{point.peak_rss_MB:8.0f}"
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def _converged(value: Converged) -> str:
    ratio, contact, peak = (value.values[name] for name in QUANTITIES)
    unsure = [_percent(value.unsure[name]) for name in QUANTITIES]
    return (
        f"{'converged':24}{'':16}{ratio:9.5f}{unsure[0]:>10}{1e6 * contact:10.3f}{unsure[1]:>10}"
        f"{peak:8.3f}{unsure[2]:>10}  (error: {unsure_words(value)})"
    )


def unsure_words(value: Converged) -> str:
    """What the uncertainty of a converged value is."""
    return "how far an exact rod is from it" if value.rod else "how far the finest ITS is from it"


def _reached(own: Sequence[Point]) -> list[str]:
    heads = [f"to {_percent(level)}" for level in LEVELS]
    line = f"{'time at equal error, s':24}{''.join(f'{head:>14}' for head in heads)}"
    lines = [line + "".join(f"{head + ', further':>18}" for head in heads)]
    for name, points in by_program(own).items():
        whole = [f"{time_words(reached(points, level)):>14}" for level in LEVELS]
        further = [f"{time_words(reached(points, level, True)):>18}" for level in LEVELS]
        lines.append(f"{name:24}{''.join(whole + further)}")
    return lines


def time_words(each: Reached) -> str:
    """Seconds, such as ``2.1``, ``≤ 0.9``, ``–`` where the error was not reached."""
    if each.time_s is None:
        return "–"
    return f"{'≤ ' if each.coarsest else ''}{each.time_s:.3g}"


def absences(runs: Sequence[Run]) -> list[str]:
    """A line for every program that is not there or failed."""
    lines = [f"{each.name:24}{each.absent()}" for each in PROGRAMS if each.absent()]
    failed = dict.fromkeys(
        f"{run.program:24}ITS {run.setting.its_s:g} s: {run.answer.why_not}"
        for run in runs
        if run.answer.why_not
    )
    return [*lines, *failed]
