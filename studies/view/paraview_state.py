"""A script that opens a result in ParaView in one step: the whole, and a camera on the tip.

``open_in_paraview.py`` is written beside the result. It finds the fields in its own folder, so a
result may be moved, and runs in ParaView's own Python, where nothing of this program is needed.
"""

from __future__ import annotations

import itertools
import pprint
from pathlib import Path
from typing import Any

import numpy as np

from ...solver.arrays import Array
from ...solver.paraview import SOLID_FILE, TIP_FILE
from ..report.page import environment
from ..running.files import write_atomically
from ..running.results import SCRIPT_FILE
from .wave import Wave

WHOLE_WIDTHS = 6.0
"""Height to which the whole is compressed, in widths of the section."""
WHOLE_SPREADS = 1.5
"""The same where the bristle leans or goes to the side, in lengths of its way across."""
WHOLE_FROM, TIP_FROM = (-1.0, -0.8, 0.35), (-1.0, -0.8, -0.9)
"""Toward the cameras: along the world's axes, and along the tip's own."""
VIEW_WIDTH = 0.75
"""Width of a view over its height."""
ROOM = 1.2
"""How much higher the view is than what it shows."""
TIP_ROOM = 2.2
"""The same of the tip's face, which stands below the middle."""


def write_state_script(result: Path, fields: str, wave: Wave, touch_s: float) -> Path:
    """Write ``open_in_paraview.py`` into the folder ``result``, whose fields are in ``fields``.

    It opens at the instant of the greatest stress near the tip. Returns its path.
    """
    width, frame = float(wave.size_m[:2].max()), wave.tip_frame
    settings: dict[str, Any] = {
        "folder": str(result.resolve()),
        "fields": fields,
        "solid": SOLID_FILE,
        "tip": TIP_FILE,
        "width_m": width,
        **_whole(wave, width),
        "exaggeration": wave.exaggeration,
        "shown_m": _exaggerated(wave),
        "tip_camera": _tip_camera(wave, width),
        "room": TIP_ROOM,
        "nearer_m": (wave.tip_stand.turn @ [0.0, 0.0, -0.005 * width]).tolist(),
        "axial_limit_Pa": wave.greatest_axial_Pa or 1.0,
        "von_mises_limit_Pa": float(wave.tip_von_mises_Pa[frame]) or 1.0,
        "time_s": float(wave.times_s[frame] + touch_s),
    }
    template = environment(Path(__file__).parent, {}).get_template(f"{SCRIPT_FILE}.j2")
    script = template.render(settings=pprint.pformat(settings, sort_dicts=False, width=96))
    path = result / SCRIPT_FILE
    write_atomically(path, f"{script}\n")
    return path


def _exaggerated(wave: Wave) -> str:
    """ParaView's formula for a displacement whose part beyond the stand is made larger."""
    stand, factor = wave.stand, wave.exaggeration
    placed = np.column_stack([stand.turn - np.eye(3), -stand.turn @ stand.touching_m])
    moved = (1.0 - factor) * placed
    parts = [f"{factor}*displacement_m", *(_along("ijk"[k], moved[k]) for k in range(3))]
    return "+".join(parts).replace("+-", "-")


def _along(axis: str, row: Array) -> str:
    x, y, z, at = map(float, row)
    return f"({x}*coordsX+{y}*coordsY+{z}*coordsZ+{at})*{axis}Hat"


def _whole(wave: Wave, width_m: float) -> dict[str, Any]:
    """The whole with its axis compressed: by how much, its camera, and the ground below it, by a
    corner and those beside it, uncompressed."""
    low, high = wave.extent_m(np.ones(3))
    height, across = high[2] - low[2], (high - low)[:2].max()
    compression = max(1.0, height / max(WHOLE_WIDTHS * width_m, WHOLE_SPREADS * across))
    (left, near), (right, far) = low[:2] - width_m, high[:2] + width_m
    corners = np.array([[left, near], [right, near], [left, far], [right, far]])
    ground = np.column_stack([corners, -corners @ wave.normal[:2] / wave.normal[2]])
    box = np.array(list(itertools.product(*np.array([low, high]).T)))

    away = np.array(WHOLE_FROM) / np.linalg.norm(WHOLE_FROM)
    right_hand = np.cross([0.0, 0.0, 1.0], away)
    right_hand /= np.linalg.norm(right_hand)
    plane = np.array([right_hand, np.cross(away, right_hand)])
    seen = np.vstack([box, ground]) / [1.0, 1.0, compression] @ plane.T
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0)) @ plane
    half = 0.5 * np.ptp(seen, axis=0) / [VIEW_WIDTH, 1.0]
    return {
        "compression": float(compression),
        "ground_m": ground[:3].tolist(),
        "camera": [away.tolist(), [0.0, 0.0, 1.0], middle.tolist(), ROOM * float(half.max())],
    }


def _tip_camera(wave: Wave, width_m: float) -> list[Any]:
    """Direction to the camera along the tip's own axes, upward, middle and half the height of the
    view; where it looks follows the tip."""
    turn = wave.tip_stand.turn
    away = turn @ (np.array(TIP_FROM) / np.linalg.norm(TIP_FROM))
    return [away.tolist(), turn[:, 2].tolist(), [0.0, 0.0, 0.0], width_m]
