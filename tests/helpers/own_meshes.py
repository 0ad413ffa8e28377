"""Mesh files as users make them: tetrahedra by gmsh's OpenCASCADE kernel, whole and spoilt."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import gmsh
import numpy as np

from bristle.meshes.hexahedra import gmsh_model

THIN, WIDE, LENGTH = 0.5e-3, 2.08e-3, 20e-3


def write(path: Path, *, size_m: float = 5e-4, order: int = 1, change: Callable | None = None):
    """Mesh what is in gmsh's current model, its tip being the faces at z = 0; returns the path."""
    gmsh.model.occ.synchronize()
    faces = [tag for _, tag in gmsh.model.getEntities(2)]
    middle = [gmsh.model.occ.getCenterOfMass(2, tag)[2] for tag in faces]
    tip = [tag for tag, z in zip(faces, middle, strict=True) if abs(z) < 1e-9]
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], name="body")
    gmsh.model.addPhysicalGroup(2, tip, name="tip")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size_m)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(order)
    if change is not None:
        change()
    gmsh.write(str(path))
    return path


def box(path: Path, cuts: Iterable[tuple[float, ...]] = (), *, length_m: float = LENGTH, **how):
    """A straight bristle less the boxes ``cuts`` (x, y, z of a corner, and sides)."""
    with gmsh_model():
        body = gmsh.model.occ.addBox(-THIN / 2, -WIDE / 2, 0.0, THIN, WIDE, length_m)
        gone = [(3, gmsh.model.occ.addBox(*cut)) for cut in cuts]
        if gone:
            gmsh.model.occ.cut([(3, body)], gone)
        return write(path, **how)


def wedge(path: Path, top_m: float, **how) -> Path:
    """A bristle whose thin side, centred on the axis, narrows evenly to ``top_m``."""
    with gmsh_model():
        occ = gmsh.model.occ
        half = np.array([THIN, THIN, top_m, top_m]) / 2 * [-1, 1, 1, -1]
        corners = zip(half, (0.0, 0.0, LENGTH, LENGTH), strict=True)
        points = [occ.addPoint(x, -WIDE / 2, z) for x, z in corners]
        lines = [occ.addLine(points[i], points[(i + 1) % 4]) for i in range(4)]
        occ.extrude([(2, occ.addPlaneSurface([occ.addCurveLoop(lines)]))], 0, WIDE, 0)
        return write(path, **how)


def moved(where: Callable[[np.ndarray], np.ndarray]) -> Callable[[], None]:
    """A change that carries every node from x (n, 3) to ``where(x)``."""

    def change() -> None:
        numbers, places, _ = gmsh.model.mesh.getNodes()
        for number, x in zip(numbers, where(places.reshape(-1, 3)), strict=True):
            gmsh.model.mesh.setNode(number, x, [])

    return change


def turned(degrees: float) -> Callable[[np.ndarray], np.ndarray]:
    """A lean of the upper end toward x, about the origin."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return lambda x: x @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
