"""Hexahedral meshes of a bristle, by gmsh.

The section is meshed with transfinite, recombined quadrilaterals and extruded layer by layer, so
all cells are hexahedra. A rectangle is one block. A circle is five (an O-grid): a square core with
bulging sides, and four blocks between it and the circle.
"""

from __future__ import annotations

import itertools
import math
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import gmsh
import numpy as np

from .geometry import MeshSpec, Tag
from .section import Circle, Rectangle

CORE_RADIUS = 0.55
"""Distance of the core's corners from the axis, over the wire's radius."""
CORE_BULGE = 0.4
"""Sagitta of the core's sides over that of a circle through its corners: 0 is a straight square,
1 a circle.  At 0.3 the three blocks that meet in a corner share it as 120° each; with the ring's
other corners counted in, the least scaled Jacobian is largest near 0.4 (0.69, for 1 to 8 cells)."""

_gmsh_lock = threading.RLock()
_model_numbers = itertools.count()

_OPTIONS = {
    "General.Terminal": 0,
    "General.SaveSession": 0,
    "General.SaveOptions": 0,
    "Mesh.ElementOrder": 1,
    "Mesh.SecondOrderIncomplete": 0,
    "Mesh.SecondOrderLinear": 0,
    "Mesh.HighOrderOptimize": 0,
    "Mesh.SubdivisionAlgorithm": 0,
    "Mesh.MshFileVersion": 4.1,
    "Mesh.Binary": 0,
    "Mesh.SaveAll": 0,
    "Mesh.ScalingFactor": 1,
}


@contextmanager
def gmsh_model(name: str = "bristle") -> Iterator[None]:
    """Provide an empty, quiet gmsh model, and restore gmsh afterwards.

    Only one thread at a time may enter, because gmsh's state is global to the process. If the
    caller has initialised gmsh, it stays initialised, with its options and its current model
    restored; otherwise it is finalised.
    """
    with _gmsh_lock:
        ours = not gmsh.isInitialized()
        if ours:
            _initialise()
        caller_model = None if ours else gmsh.model.getCurrent()
        caller_options = {option: gmsh.option.getNumber(option) for option in _OPTIONS}
        try:
            for option, value in _OPTIONS.items():
                gmsh.option.setNumber(option, value)
            gmsh.model.add(f"{name}-{next(_model_numbers)}")
            yield
        finally:
            if ours:
                gmsh.finalize()
            else:
                gmsh.model.remove()
                for option, value in caller_options.items():
                    gmsh.option.setNumber(option, value)
                gmsh.model.setCurrent(caller_model)


def _initialise() -> None:
    """Initialise gmsh, also outside the main thread, without leaving files behind."""
    home = os.environ.get("HOME")
    # gmsh's GUI toolkit would create a folder .fltk there, even without windows.
    os.environ["HOME"] = os.devnull
    try:
        gmsh.initialize(readConfigFiles=False, run=False, interruptible=False)
    finally:
        if home is None:
            del os.environ["HOME"]
        else:
            os.environ["HOME"] = home


def build_model(spec: MeshSpec) -> None:
    """Mesh `spec` in gmsh's current model, with the physical groups of `Tag`.

    Call it inside `gmsh_model`.  Nodes are numbered from 1 without gaps, all facet normals point
    outward, lengths are in metres.  The mesh is not checked here: see `bristle.meshes.check`.
    """
    if isinstance(spec.section, Rectangle):
        surfaces = _rectangle_section(spec.section, *spec.cells[:2])
    else:
        surfaces = _wire_section(spec.section, *spec.cells[:2])
    _extrude(surfaces, spec)
    _remove_construction_points()
    gmsh.model.mesh.generate(3)
    if spec.geometry_order > 1:
        gmsh.model.mesh.setOrder(spec.geometry_order)
    _orient_outward()
    gmsh.model.mesh.renumberNodes()
    gmsh.model.mesh.renumberElements()


def _block(curves: list[int]) -> int:
    """Make a transfinite, recombined four-sided surface and return its tag."""
    geo = gmsh.model.geo
    surface = geo.addPlaneSurface([geo.addCurveLoop(curves)])
    geo.mesh.setTransfiniteSurface(surface)
    geo.mesh.setRecombine(2, surface)
    return surface


def _rectangle_section(section: Rectangle, nx: int, ny: int) -> list[int]:
    geo = gmsh.model.geo
    x, y = section.thickness_m / 2, section.width_m / 2
    corners = [geo.addPoint(*xy, 0.0) for xy in ((-x, -y), (x, -y), (x, y), (-x, y))]
    sides = [geo.addLine(a, b) for a, b in zip(corners, np.roll(corners, -1), strict=True)]
    for side, count in zip(sides, (nx, ny, nx, ny), strict=True):
        geo.mesh.setTransfiniteCurve(side, count + 1)
    return [_block(sides)]


def _ring_points(radius_m: float) -> list[int]:
    angles = math.pi / 4 + math.pi / 2 * np.arange(4)
    return [
        gmsh.model.geo.addPoint(radius_m * math.cos(a), radius_m * math.sin(a), 0.0) for a in angles
    ]


def _arcs(points: list[int], radius_m: float, bulge: float, cells: int) -> list[int]:
    """Join four points on the diagonals by arcs.

    The arc's sagitta is `bulge` times that of the circle through the four points.
    """
    geo = gmsh.model.geo
    half_chord = radius_m * math.sin(math.pi / 4)
    sagitta = bulge * (radius_m - half_chord)
    # Radius of the arc's circle, and distance of its centre from the axis.
    arc_radius = (half_chord**2 + sagitta**2) / (2 * sagitta)
    offset = arc_radius - half_chord - sagitta
    arcs = []
    for quarter in range(4):
        middle = math.pi / 2 * (quarter + 1)
        centre = geo.addPoint(-offset * math.cos(middle), -offset * math.sin(middle), 0.0)
        arc = geo.addCircleArc(points[quarter], centre, points[(quarter + 1) % 4])
        geo.mesh.setTransfiniteCurve(arc, cells + 1)
        arcs.append(arc)
    return arcs


def _wire_section(section: Circle, nx: int, ny: int) -> list[int]:
    geo = gmsh.model.geo
    radius = section.diameter_m / 2
    outer, inner = _ring_points(radius), _ring_points(CORE_RADIUS * radius)
    rim = _arcs(outer, radius, 1.0, nx)
    core = _arcs(inner, CORE_RADIUS * radius, CORE_BULGE, nx)
    spokes = [geo.addLine(i, o) for i, o in zip(inner, outer, strict=True)]
    for spoke in spokes:
        geo.mesh.setTransfiniteCurve(spoke, ny + 1)
    ring = [_block([spokes[q], rim[q], -spokes[(q + 1) % 4], -core[q]]) for q in range(4)]
    return [_block(core), *ring]


def _extrude(surfaces: list[int], spec: MeshSpec) -> None:
    """Extrude the section along z in the layers of `spec` and name the groups."""
    geo = gmsh.model.geo
    levels = spec.levels_m
    extruded = geo.extrude(
        [(2, surface) for surface in surfaces],
        0.0,
        0.0,
        spec.length_m,
        numElements=[1] * spec.cells[2],
        heights=list(levels[1:] / levels[-1]),
        recombine=True,
    )
    geo.synchronize()
    volumes = [tag for dim, tag in extruded if dim == 3]
    position = [i for i, (dim, _) in enumerate(extruded) if dim == 3]
    tops = [extruded[i - 1][1] for i in position]
    boundary = gmsh.model.getBoundary([(3, v) for v in volumes], combined=True, oriented=False)
    sides = sorted({tag for _, tag in boundary} - set(surfaces) - set(tops))
    _name_group(3, volumes, Tag.BODY)
    for tag, faces in ((Tag.TIP, surfaces), (Tag.TOP, tops), (Tag.SIDE, sides)):
        _name_group(2, faces, tag)


def _remove_construction_points() -> None:
    """Remove the centres of arcs, which would otherwise become nodes of no cell."""
    points = gmsh.model.getEntities(0)
    unused = [point for point in points if not len(gmsh.model.getAdjacencies(*point)[0])]
    gmsh.model.removeEntities(unused)


def _orient_outward() -> None:
    """Turn the facets so that their normals leave the body."""
    for tag in (Tag.TIP, Tag.TOP, Tag.SIDE):
        for face in gmsh.model.getEntitiesForPhysicalGroup(2, tag):
            (kind,) = gmsh.model.mesh.getElementTypes(2, face)
            jacobians, _, points = gmsh.model.mesh.getJacobians(kind, [0.0, 0.0, 0.0], face)
            tangents = jacobians.reshape(-1, 3, 3)[:, :2]
            normal = np.cross(tangents[0, 0], tangents[0, 1])
            x, y, _ = points[:3]
            outward = {Tag.TIP: (0, 0, -1), Tag.TOP: (0, 0, 1), Tag.SIDE: (x, y, 0)}[tag]
            if normal @ outward < 0:
                gmsh.model.mesh.reverse([(2, face)])


def _name_group(dim: int, entities: list[int], tag: Tag) -> None:
    gmsh.model.addPhysicalGroup(dim, entities, int(tag), name=tag.name.lower())
