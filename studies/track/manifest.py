"""``dataset.toml`` of tracked films: the body, the measurement and its errors."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ...solver import paper
from ..film.scale import touching_px
from ..inputs.choices import Body
from ..report.page import environment
from .films import TABLE, TrackedFilms

STEEL_KG_M3 = 7800.0
UNKNOWN_BALL_MM = 10.0


def manifest(found: TrackedFilms) -> str:
    """``dataset.toml`` of the tracks."""
    inputs, films = found.inputs, found.films
    names = ", ".join(each.track.film.path.name for each in films)
    ball_mm = _ball_mm(found) if inputs.body is Body.BALL else 0.0
    steel_kg = STEEL_KG_M3 * math.pi / 6.0 * (1e-3 * ball_mm) ** 3
    surfaces = [each.by * np.hypot(each.floor[1], touching_px(each.track.drops)) for each in films]
    templates = environment(Path(__file__).parent, {})
    text: str = templates.get_template("dataset.toml.j2").render(
        found=found,
        inputs=inputs,
        paper=paper,
        table=TABLE,
        names=_quoted(names[:700]),
        ball_mm=ball_mm,
        ball_kg=1e-3 * inputs.mass_g if inputs.mass_g else steel_kg,
        other_length=inputs.length_mm and abs(inputs.length_mm - 1e3 * paper.LENGTH_M) > 1e-6,
        surface=max(surfaces),
        scales=[each.scale for each in films if each.scale is not None],
        width_mm=np.median([each.by * each.track.width for each in films]),
    )
    return text


def _ball_mm(found: TrackedFilms) -> float:
    """The ball's diameter, as given or as the films show it."""
    if found.inputs.diameter_mm:
        return found.inputs.diameter_mm
    if found.unit == "px":
        return UNKNOWN_BALL_MM
    return float(np.median([each.by * np.nanmedian(each.track.length) for each in found.films]))


def _quoted(text: str) -> str:
    """A text as it may stand in a string of TOML."""
    safe = "".join(each if each.isprintable() else "?" for each in text)
    return safe.replace("\\", "\\\\").replace('"', '\\"')
