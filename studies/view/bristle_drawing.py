"""Pictures of the deformed bristle at some frames, seen straight from one side, and of its tip.

`draw_bristle` is what to call; the drawing itself is this module run as a program, because VTK
needs a display and takes the process down where it has none (`bristle.meshes.display`). That
program gets its numbers through files, the outside of the mesh alone and a file a frame, so that
neither process holds more than a frame; and it keeps clear of MPI: under mpirun it would take
itself for the rank that started it.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
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
    from .wave import Wave

PIXELS_PER_HEIGHT = 720
TIP_PIXELS = (700, 720)
TIP_WIDTHS = 1.6
"""Length of bristle in the close-up, in widths of the section."""
FAR = 10.0
"""Distance of the camera, in widths of what it sees."""
COLOURS, TIP_COLOURS = "RdBu_r", "viridis"
OUTLINE, OUTLINE_PIXELS = 0.35, 2
TIP_FROM = (-1.0, -0.8, -0.6)
"""Toward the camera, along the bristle's axes: the tip is seen from below."""

DRAWING_FILE, PIECES_FILE = "drawing.json", "pieces.npy"
TIP_FILE, TIP_PIECES_FILE = "tip.npy", "tip-pieces.npy"

Array = NDArray[np.float64]
Pixels = NDArray[np.float32]


@dataclass(frozen=True)
class Drawing:
    """What to draw: which frames, how large displacements, in which window and colours.

    ``side`` is 0 or 1, the lateral axis that runs to the right. ``window_m`` (left, right, bottom,
    top) is in that axis of the world and z, after displacements are multiplied by ``exaggeration``
    and the section by ``widening``; z is compressed so that the picture gets ``width_to_height``.
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
    series: FieldSeries,
    wave: Wave,
    drawing: Drawing,
    advance: Callable[[], None] = lambda: None,
    timeout_s: float = 600.0,
) -> tuple[list[Pixels], Pixels]:
    """The frames as images (height, width, 3) in [0, 1], and the close-up of the tip.

    ``wave`` was read from ``series``. ``advance`` is called for each frame that is drawn.

    Raises
    ------
    DrawingError : there is no display, or drawing failed
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / DRAWING_FILE).write_text(json.dumps(asdict(drawing)))
        save_frames(series, wave, drawing, folder)
        _save_tip(series, wave, drawing, folder)
        run_drawing([sys.executable, "-m", __name__, str(folder)], timeout_s, advance)
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


def save_frames(series: FieldSeries, wave: Wave, drawing: Drawing, folder: Path) -> None:
    """The places in the world (m), as they are drawn, and stresses of what is outside."""
    shown, pieces = compact(outside(series))
    np.save(folder / PIECES_FILE, pieces)
    nodes = series.nodes_m[shown]
    for number, frame in enumerate(drawing.frames):
        moved = wave.stand.moved(nodes, series.read("displacement_m", frame)[shown])
        placed = wave.stand.drawn(nodes, moved, drawing.exaggeration, wave.widenings)
        stress = series.read("axial_stress_Pa", frame)[shown]
        np.save(folder / f"{number}.npy", np.column_stack([placed, stress]))


def _save_tip(series: FieldSeries, wave: Wave, drawing: Drawing, folder: Path) -> None:
    """The same of the tip, along its own axes."""
    nodes = series.nodes_m
    width = float(np.ptp(nodes[:, :2], axis=0).max())
    layer = float(np.ptp(nodes[series.cells, 2], axis=1).max())
    shown, pieces = compact(outside(series, TIP_WIDTHS * width + layer))
    np.save(folder / TIP_PIECES_FILE, pieces)
    displacement = series.read("displacement_m", drawing.tip_frame)[shown]
    placed = nodes[shown] + wave.tip_stand.moved(nodes[shown], displacement)
    stress = series.read("von_mises_Pa", drawing.tip_frame)[shown]
    np.save(folder / TIP_FILE, np.column_stack([placed, stress]))


def outside(series: FieldSeries, below_m: float = np.inf) -> NDArray[np.int64]:
    """The outside of the cells that lie below a height, in flat pieces (m, 3 or 4) between nodes.

    Each face is split at its nodes.
    """
    nodes, cells = series.nodes_m, series.cells
    cells = cells[(nodes[cells, 2] <= below_m).all(axis=1)]
    counted = np.insert(cells, 0, cells.shape[1], axis=1).ravel()
    kinds = np.full(len(cells), series.cell_type, np.uint8)
    grid: Any = pyvista.UnstructuredGrid(counted, kinds, nodes)
    grid.point_data["node"] = np.arange(len(nodes), dtype=float)
    split = 1 if cells.shape[1] > 8 else 0
    surface = grid.extract_surface(nonlinear_subdivision=split)
    node = np.round(surface.point_data["node"]).astype(np.int64)
    if np.abs(surface.points - nodes[node]).max() > 1e-6 * np.ptp(nodes):
        raise ValueError("the faces of the mesh are not split at their nodes")
    return node[surface.faces.reshape(-1, 1 + surface.faces[0])[:, 1:]]


def compact(pieces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The nodes that pieces (m, k) have, and the pieces by their places among these."""
    nodes, places = np.unique(pieces, return_inverse=True)
    return nodes, places.reshape(pieces.shape)


def _surface(folder: Path, numbers: str, pieces: str) -> pyvista.PolyData:
    """What was saved of a frame, its stress as ``value``."""
    values = np.load(folder / numbers, allow_pickle=False)
    corners = np.load(folder / pieces, allow_pickle=False)
    faces = np.insert(corners, 0, corners.shape[1], axis=1)
    surface = pyvista.PolyData(values[:, :3], faces=faces.ravel())
    surface.point_data["value"] = values[:, 3]
    return surface


def _draw(drawing: Drawing, folder: Path) -> None:
    """Write all images, and a line for each frame; needs a display. One window serves all."""
    left, right, bottom, top = drawing.window_m
    squeeze = (right - left) / drawing.width_to_height / (top - bottom)
    plotter = pyvista.Plotter(
        off_screen=True,
        window_size=(round(PIXELS_PER_HEIGHT * drawing.width_to_height), PIXELS_PER_HEIGHT),
    )
    plotter.background_color = "white"
    plotter.enable_parallel_projection()  # type: ignore[call-arg]
    _aim_from_the_side(plotter, drawing, squeeze)
    limits = (-drawing.limit_Pa, drawing.limit_Pa)
    for number in range(len(drawing.frames)):
        surface: Any = _surface(folder, f"{number}.npy", PIECES_FILE)
        surface.points *= [1.0, 1.0, squeeze]
        _show(plotter, surface, COLOURS, limits)
        plotter.camera.clipping_range = (0.1 * FAR * (right - left), 10.0 * FAR * (right - left))
        plotter.screenshot(str(folder / f"{number}.png"))
        print(number, flush=True)
    _draw_tip(plotter, _surface(folder, TIP_FILE, TIP_PIECES_FILE), drawing.tip_limit_Pa)
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


def _draw_tip(plotter: pyvista.Plotter, surface: Any, limit_Pa: float) -> None:
    surface = surface.clean()
    _show(plotter, surface, TIP_COLOURS, (0.0, limit_Pa))
    plotter.add_mesh(surface.extract_feature_edges(45.0), color="black", line_width=2.0)
    plotter.window_size = TIP_PIXELS
    plotter.camera.focal_point = surface.center
    plotter.camera.position = surface.center + FAR * surface.length * np.array(TIP_FROM)
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
    _draw(Drawing(**json.loads((where / DRAWING_FILE).read_text())), where)
