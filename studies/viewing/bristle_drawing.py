"""What does the deformed bristle look like at some frames, seen straight from one side?

`draw_bristle` is what to call; the drawing itself is this module run as a program, because VTK
needs a display and takes the process down where it has none (`bristle.meshes.display`). That
program gets its numbers through a file and keeps clear of MPI: under mpirun it would take itself
for the rank that started it.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvista
from matplotlib.image import imread
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from ...meshes.display import run_drawing

if TYPE_CHECKING:
    from .field_series import FieldSeries
    from .stand import Stand

PIXELS_PER_HEIGHT = 720
TIP_PIXELS = (700, 720)
TIP_WIDTHS = 1.6
"""Length of bristle in the close-up, in widths of the section."""
FAR = 10.0
"""Distance of the camera, in widths of what it sees."""
COLOURS, TIP_COLOURS = "RdBu_r", "viridis"
OUTLINE, OUTLINE_PIXELS = 0.35, 2
TIP_FROM = (-1.0, -0.8, -0.6)
"""Toward the camera: the tip is seen from below."""

DRAWING_FILE, NUMBERS_FILE = "drawing.json", "numbers.npz"

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]


@dataclass(frozen=True)
class Drawing:
    """What to draw: which frames, how large displacements, in which window and colours.

    ``side`` is 0 or 1, the lateral axis that runs to the right. ``window_m`` (left, right, bottom,
    top) is in that axis and z, after displacements are multiplied by ``exaggeration`` and the
    section by ``widening``; z is compressed so that the picture gets ``width_to_height``.
    ``limit_Pa`` is the stress at either end of the colours. ``tip_frame`` is drawn near the tip in
    true proportions.
    """

    frames: list[int]
    side: int
    window_m: tuple[float, float, float, float]
    width_to_height: float
    exaggeration: float
    widening: float
    limit_Pa: float
    tip_frame: int
    tip_limit_Pa: float


def draw_bristle(
    series: FieldSeries, stand: Stand, drawing: Drawing, timeout_s: float = 600.0
) -> tuple[list[Pixels], Pixels]:
    """The frames as images (height, width, 3) in [0, 1], and the close-up of the tip.

    Frames show displacements from the ``stand``.

    Raises
    ------
    DrawingError : there is no display, or drawing failed
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / DRAWING_FILE).write_text(json.dumps(asdict(drawing)))
        np.savez(folder / NUMBERS_FILE, **_numbers(series, stand, drawing))
        run_drawing([sys.executable, "-m", __name__, str(folder)], timeout_s)
        images = [imread(folder / f"{i}.png")[..., :3] for i in range(len(drawing.frames))]
        frames = [outlined(image) for image in images]
        return frames, imread(folder / "tip.png")[..., :3]


def outlined(image: Pixels) -> Pixels:
    """What is drawn on white with a grey rim: where there is no stress it is all but white.

    A bristle so thin in its picture that the rim would cover its colours has none.
    """
    drawn = (image < 1.0).any(axis=-1)
    inside = binary_erosion(drawn, iterations=OUTLINE_PIXELS)
    if inside.sum() < 0.5 * drawn.sum():
        return image
    return np.where((drawn & ~inside)[..., None], np.float32(OUTLINE), image)


def _numbers(series: FieldSeries, stand: Stand, drawing: Drawing) -> dict[str, Any]:
    """What the program needs of a series."""
    return {
        "nodes_m": series.nodes_m,
        "cells": series.cells,
        "cell_type": series.cell_type,
        "displacement_m": [
            stand.moved(series.nodes_m, series.read("displacement_m", frame))
            for frame in drawing.frames
        ],
        "axial_stress_Pa": [series.read("axial_stress_Pa", frame) for frame in drawing.frames],
        "tip_displacement_m": series.read("displacement_m", drawing.tip_frame),
        "von_mises_Pa": series.read("von_mises_Pa", drawing.tip_frame),
    }


@dataclass(frozen=True)
class Outside:
    """The outside of the mesh in flat pieces (m, 3 or 4) between its nodes."""

    nodes_m: Array
    pieces: NDArray[np.int64]

    def at(self, points: Array, values: Array) -> pyvista.PolyData:
        """The surface with its nodes at ``points`` (n, 3), with ``values`` (n,)."""
        faces = np.insert(self.pieces, 0, self.pieces.shape[1], axis=1)
        surface = pyvista.PolyData(points, faces=faces.ravel())
        surface.point_data["value"] = values
        return surface


def outside(
    nodes_m: Array, cells: NDArray[np.int64], cell_type: int, below_m: float = np.inf
) -> Outside:
    """The outside of the hexahedra that lie below a height, each face split at its nodes."""
    hexahedra = cells[(nodes_m[cells, 2] <= below_m).all(axis=1)]
    counted = np.insert(hexahedra, 0, hexahedra.shape[1], axis=1).ravel()
    kinds = np.full(len(hexahedra), cell_type, np.uint8)
    grid: Any = pyvista.UnstructuredGrid(counted, kinds, nodes_m)
    grid.point_data["node"] = np.arange(len(nodes_m), dtype=float)
    split = 1 if hexahedra.shape[1] > 8 else 0
    surface = grid.extract_surface(nonlinear_subdivision=split)
    node = np.round(surface.point_data["node"]).astype(np.int64)
    if np.abs(surface.points - nodes_m[node]).max() > 1e-6 * np.ptp(nodes_m):
        raise ValueError("the faces of the mesh are not split at their nodes")
    pieces = surface.faces.reshape(-1, 1 + surface.faces[0])[:, 1:]
    return Outside(nodes_m, node[pieces])


def _draw(numbers: Mapping[str, Any], drawing: Drawing, folder: Path) -> None:
    """Write all images; needs a display. One window serves all."""
    left, right, bottom, top = drawing.window_m
    squeeze = (right - left) / drawing.width_to_height / (top - bottom)
    nodes = numbers["nodes_m"]
    body = outside(nodes, numbers["cells"], int(numbers["cell_type"]))
    plotter = pyvista.Plotter(
        off_screen=True,
        window_size=(round(PIXELS_PER_HEIGHT * drawing.width_to_height), PIXELS_PER_HEIGHT),
    )
    plotter.background_color = "white"
    plotter.enable_parallel_projection()  # type: ignore[call-arg]
    _aim_from_the_side(plotter, drawing, squeeze)
    limits = (-drawing.limit_Pa, drawing.limit_Pa)
    widened = np.ones(3)
    widened[drawing.side] = drawing.widening
    states = zip(numbers["displacement_m"], numbers["axial_stress_Pa"], strict=True)
    for number, (displacement, stress) in enumerate(states):
        moved = nodes * widened + drawing.exaggeration * displacement
        _show(plotter, body.at(moved * [1.0, 1.0, squeeze], stress), COLOURS, limits)
        plotter.camera.clipping_range = (0.1 * FAR * (right - left), 10.0 * FAR * (right - left))
        plotter.screenshot(str(folder / f"{number}.png"))
    _draw_tip(plotter, numbers, drawing.tip_limit_Pa)
    plotter.screenshot(str(folder / "tip.png"))
    plotter.close()


def _aim_from_the_side(plotter: pyvista.Plotter, drawing: Drawing, squeeze: float) -> None:
    left, right, bottom, top = drawing.window_m
    centre = np.array([0.0, 0.0, 0.5 * (bottom + top) * squeeze])
    centre[drawing.side] = 0.5 * (left + right)
    toward = np.zeros(3)
    # so that the lateral axis runs to the right
    toward[1 - drawing.side] = -1.0 if drawing.side == 0 else 1.0
    plotter.camera.focal_point, plotter.camera.up = centre, (0.0, 0.0, 1.0)
    plotter.camera.position = centre + FAR * (right - left) * toward
    plotter.camera.parallel_scale = 0.5 * (top - bottom) * squeeze


def _draw_tip(plotter: pyvista.Plotter, numbers: Mapping[str, Any], limit_Pa: float) -> None:
    nodes, cells = numbers["nodes_m"], numbers["cells"]
    width = float(np.ptp(nodes[:, :2], axis=0).max())
    layer = float(np.ptp(nodes[cells, 2], axis=1).max())
    near = outside(nodes, cells, int(numbers["cell_type"]), TIP_WIDTHS * width + layer)
    surface: Any = near.at(nodes + numbers["tip_displacement_m"], numbers["von_mises_Pa"])
    surface = surface.clean()
    _show(plotter, surface, TIP_COLOURS, (0.0, limit_Pa))
    plotter.add_mesh(surface.extract_feature_edges(45.0), color="black", line_width=2.0)
    focus = np.array(surface.center)
    plotter.window_size = TIP_PIXELS
    plotter.camera.focal_point = focus
    plotter.camera.position = focus + FAR * width * np.array(TIP_FROM)
    plotter.reset_camera(bounds=surface.bounds)  # type: ignore[call-arg]


def _show(
    plotter: pyvista.Plotter,
    surface: pyvista.PolyData,
    colours: str,
    limits: tuple[float, float],
) -> None:
    plotter.add_mesh(
        surface,
        name="bristle",
        scalars="value",
        cmap=colours,
        clim=limits,
        n_colors=256,
        lighting=False,
        show_scalar_bar=False,
        reset_camera=False,
    )


if __name__ == "__main__":
    where = Path(sys.argv[1])
    with np.load(where / NUMBERS_FILE, allow_pickle=False) as loaded:
        _draw(dict(loaded), Drawing(**json.loads((where / DRAWING_FILE).read_text())), where)
