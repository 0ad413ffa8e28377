"""Rebound against contact stiffness, height (Fig. 13), and any other input.

Writes table.csv, heights.svg and .png, and sweep.json. Also a script:
``mpirun -n 4 python3 -m bristle.studies.sweep --models beam,reduced``.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from matplotlib.figure import Figure
from pydantic import (
    ModelWrapValidatorHandler,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from ..solver import paper
from ..solver.arrays import Array
from .command.script import as_script
from .inputs.choices import Model
from .inputs.fields import SHARED_FLAGS, read_items
from .inputs.flags import refuse
from .inputs.sources import EXCLUDED, resolved_from
from .report.figures import (
    BLACK,
    LOOKS,
    end_labels,
    model_legend,
    panels,
    picture,
    picture_files,
    sequence,
    stiffness_label,
    styled,
    write_picture,
)
from .running.files import read_csv, remove
from .running.mark import Mark
from .running.progress import say
from .running.study import (
    COLUMNS,
    LIST_FIELDS,
    TABLE_FILE,
    Row,
    Study,
    StudyInputs,
    check_number,
    run_study,
)

FIGURE = "heights"
MARKERS = 60
MOST_PICTURES = 24
Curve = tuple[Array, Array]
LISTED = {flag.field: flag.kind for flag in SHARED_FLAGS if flag.may_be_several}


class SweepInputs(StudyInputs):
    """Lists of models, stiffnesses, heights and time steps, and of any other number or choice."""

    _given: dict[str, Any] = PrivateAttr(default_factory=dict)
    _lists: dict[str, tuple[Any, ...]] = PrivateAttr(default_factory=dict)

    @model_validator(mode="wrap")
    @classmethod
    def _several(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Inputs with the first value of each list, which keep what was given and the lists."""
        if not isinstance(data, dict):
            return handler(data)
        items = {name: _items(name, data[name]) for name in LISTED if data.get(name) is not None}
        first = {**data, **{name: values[0] for name, values in items.items()}}
        inputs = handler(first)
        own = {name: value for name, value in first.items() if name not in LIST_FIELDS}
        inputs._given = {name: value for name, value in own.items() if value is not None}
        inputs._lists = {name: values for name, values in items.items() if len(values) > 1}
        lists = (inputs.models, inputs.kn_N_m, inputs.heights_m, inputs.its_s)
        check_number(*lists, *inputs._lists.values())
        return inputs

    @property
    def varied(self) -> tuple[str, ...]:
        return tuple(self._lists)

    def shared(self) -> list[dict[str, Any]]:
        return [
            {**self._given, **dict(zip(self._lists, values, strict=True))}
            for values in itertools.product(*self._lists.values())
        ]

    @model_serializer(mode="wrap")
    def _with_lists(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """The inputs with their lists, without what follows from a value that differs."""
        excluded = {name for above in self._lists for name in EXCLUDED.get(above, ())}
        follows = resolved_from(self._lists, material="material" in self._given)
        left_out = (excluded | follows) - self._given.keys()
        plain = {name: None if name in left_out else value for name, value in handler(self).items()}
        return plain | self._lists


def _items(name: str, value: Any) -> tuple[Any, ...]:
    try:
        items = read_items(LISTED[name], value)
    except ValueError as error:
        refuse(name, str(error))
    if not items:
        refuse(name, "is an empty list")
    return items


def study_of(inputs: SweepInputs) -> Study:
    """The sweep as a study."""
    finish = partial(_finish, inputs.varied)
    files = tuple(name for stem in _pictures(inputs) for name in picture_files(stem))
    return Study("sweep", finish, curves=True, varied=inputs.varied, files=files)


def run_sweep(inputs: SweepInputs, out: Path, **how: Any) -> None:
    """Compute a sweep into the folder ``out``, as `study.run_study`."""
    run_study(study_of, inputs, out, **how)


def _finish(varied: Sequence[str], rows: Sequence[Row], out: Path) -> dict[str, Any]:
    """A figure for each ITS of the sweep, and each combination of what is ``varied`` besides."""
    pictures: dict[str, list[Row]] = {}
    steps = {row["its_s"] for row in rows}
    for row in sorted(rows, key=lambda row: -row["its_s"]):
        pictures.setdefault(_stem(row, steps, varied), []).append(row)
    names: list[str] = []
    if len(pictures) > MOST_PICTURES:
        say(f"no figures: {len(pictures)} would be drawn, and {MOST_PICTURES} are the most")
        pictures.clear()
    for name, members in pictures.items():
        curves = {(row["model"], row["y0_m"], row["kn_N_m"]): _path(row) for row in members}
        names += write_picture(out / name, picture(height_figure(curves)))
    ours = re.compile(rf"{FIGURE}[-.\w+]*\.(svg|png)")
    remove(*(out / name for name in Mark.read(out).files if ours.fullmatch(name)))
    return {"files": names}


def _pictures(inputs: StudyInputs) -> set[str]:
    """The names of the sweep's pictures without their endings, none where they are too many."""
    rows = ({**shared, "its_s": its} for shared in inputs.shared() for its in inputs.its_s)
    stems = {_stem(row, inputs.its_s, inputs.varied) for row in rows}
    return stems if len(stems) <= MOST_PICTURES else set()


def _stem(row: Mapping[str, Any], steps: Collection[float], varied: Sequence[str]) -> str:
    """The name of the picture that a row is drawn in."""
    named = [("its", row["its_s"])] if len(set(steps)) > 1 else []
    named += [(name, row[name]) for name in varied]
    words = [f"{name}-{x:.12g}" if isinstance(x, float) else f"{name}-{x}" for name, x in named]
    return "-".join([FIGURE, *words])


@styled
def height_figure(histories: Mapping[tuple[str, float, float], Curve]) -> Figure:
    """Fig. 13: tip height (mm) against time (ms), a panel per height; keys (model, height, Kn)."""
    heights = sorted({height for _, height, _ in histories})
    stiffnesses = sorted({kn for _, _, kn in histories})
    models = [model for model in LOOKS if any(m == model for m, _, _ in histories)]
    colours = sequence(len(stiffnesses))
    figure, axes = panels(len(heights), 1, height_in=0.5 + 2.3 * len(heights), sharex=True)
    for ax, height in zip(axes[:, 0], heights, strict=True):
        last = []
        for kn, colour in zip(stiffnesses, colours, strict=True):
            for model in models:
                t, y = histories[model, height, kn]
                look = {"color": colour, **LOOKS[model].line}
                if model != models[0]:  # it lies on the first one's line: black and thin shows both
                    look |= {"color": BLACK, "linewidth": 0.7, "markersize": 2.5}
                ax.plot(1e3 * t, 1e3 * y, **look)
            after = histories[models[0], height, kn]
            last.append(1e3 * float(after[1][len(after[1]) // 2 :].max()))
        ax.set(ylabel="tip height (mm)", ylim=(-0.02e3 * height, 1.05e3 * height))
        ax.set_title(f"y0 = {1e3 * height:g} mm")
        figure.draw_without_rendering()
        end_labels(ax, last, [stiffness_label(kn) for kn in stiffnesses], colours)
    axes[-1, 0].set(xlabel="time after release (ms)", xlim=(0, None))
    model_legend(axes[-1, 0], models, loc="lower left")
    return figure


def answer(out: Path) -> list[str]:
    """What a finished sweep in ``out`` says, as lines: y1/y0 over stiffness and height for each
    model and each combination of further lists, and at which Kn it is the paper's."""
    rows = read_csv(out / TABLE_FILE)
    if not any(row["rebound_ratio"] for row in rows):
        return ["no rebound was computed: --until ends the drops before it"]
    several = ["contact"] if len({row["contact"] for row in rows}) > 1 else []
    varied = several + [name for name in rows[0] if name not in COLUMNS]
    parts: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for row in rows:
        parts.setdefault(tuple(row[name] for name in ("model", "its_s", *varied)), []).append(row)
    lines: list[str] = []
    for (model, its_s, *values), members in parts.items():
        at = (f", {name} {value}" for name, value in zip(varied, values, strict=True))
        ratio = {
            (float(row["kn_N_m"]), float(row["y0_m"])): float(row["rebound_ratio"] or "nan")
            for row in members
        }
        kns, heights = (sorted({key[i] for key in ratio}) for i in range(2))
        lines += [f"{model}, ITS {float(its_s):g} s{''.join(at)}: y1/y0", "  Kn (N/m) from (mm)"]
        lines[-1] += "".join(f"{1e3 * height:9.4g}" for height in heights)
        for kn in kns:
            ratios = "".join(f"{ratio[kn, height]:9.4f}" for height in heights)
            lines.append(f"  {kn:<18.6g}{ratios}")
        found = _kn_of(paper.RATIO_MEAN, kns, [ratio[kn, heights[-1]] for kn in kns])
        if found is not None:
            lines.append(
                f"  y1/y0 is {paper.RATIO_MEAN:g}, the paper's mean, from {1e3 * heights[-1]:g} mm "
                f"at Kn = {found:.3g} N/m"
            )
    return lines


def _kn_of(ratio: float, kns: Sequence[float], ratios: Sequence[float]) -> float | None:
    """Where ``ratio`` is passed between two stiffnesses, by their logarithms; None if nowhere."""
    above = np.array(ratios) > ratio
    turns = np.flatnonzero(above[1:] != above[:-1])
    finite = np.isfinite(ratios) & np.isfinite(kns)
    if len(turns) != 1 or not finite[turns[0] : turns[0] + 2].all():
        return None
    i = int(turns[0])
    share = (ratio - ratios[i]) / (ratios[i + 1] - ratios[i])
    return float(kns[i] * (kns[i + 1] / kns[i]) ** share)


def _path(row: Row) -> Curve:
    """Times and heights; few where the model is drawn by markers."""
    t, y = (np.array(row["curve"][name]) for name in ("t_s", "tip_y_m"))
    if row["model"] == Model.SOLID:
        keep = np.searchsorted(t, np.linspace(t[0], t[-1], MARKERS))
        return t[keep], y[keep]
    return t, y


if __name__ == "__main__":
    as_script("sweep")
