"""How does a bristle's mesh get onto the ranks of a dolfinx run?"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

import basix
import gmsh
import numpy as np
from dolfinx.io import gmshio
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI

from .check import (
    VOLUME_TOLERANCE,
    MeshError,
    check_model,
    determinant_degree,
    meshed_volume_m3,
)
from .collective import run_on_one_rank
from .geometry import MeshSpec, Tag
from .hexahedra import build_model, gmsh_model

__all__ = ["MeshError", "Tag", "count_facets", "to_dolfinx", "volume_m3"]

BUILDER_RANK = 0


def to_dolfinx(
    spec: MeshSpec,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    partitioner: Callable | None = None,
) -> tuple[Mesh, MeshTags, MeshTags]:
    """Build the mesh of `spec` on rank 0 and share it out; collective.

    Parameters
    ----------
    spec : the bristle
    comm : communicator over which the cells are distributed
    partitioner : as in `dolfinx.mesh.create_mesh`; by default dolfinx' own, without ghost cells

    Returns
    -------
    (mesh, cell_tags, facet_tags) : coordinates in metres, geometry of `spec.geometry_order`;
        the values of both tags are those of `Tag`, e.g. ``facet_tags.find(Tag.TIP)``

    Raises
    ------
    MeshError : gmsh failed, or the mesh is not what was asked for; on all ranks, with one message
    """
    with ExitStack() as open_model:
        run_on_one_rank(comm, lambda: _open_checked_model(spec, open_model), BUILDER_RANK)
        mesh, cell_tags, facet_tags = gmshio.model_to_mesh(
            gmsh.model if comm.rank == BUILDER_RANK else None,
            comm,
            BUILDER_RANK,
            gdim=3,
            partitioner=partitioner,
        )
    mesh.name, cell_tags.name, facet_tags.name = "bristle", "cell_tags", "facet_tags"
    _check_distributed(spec, mesh, facet_tags)
    return mesh, cell_tags, facet_tags


def count_facets(mesh: Mesh, facet_tags: MeshTags, tag: Tag) -> int:
    """Return how many facets of all ranks together carry the tag; collective."""
    n_owned = mesh.topology.index_map(mesh.topology.dim - 1).size_local
    return mesh.comm.allreduce(int(np.count_nonzero(facet_tags.find(tag) < n_owned)))


def volume_m3(mesh: Mesh, geometry_order: int) -> float:
    """Return the volume of all ranks' cells, m³; collective. No form, which would be compiled."""
    map_ = mesh.geometry.cmap
    element = basix.create_element(
        basix.ElementFamily.P,
        basix.CellType.hexahedron,
        map_.degree,
        basix.LagrangeVariant(map_.variant),
    )
    points, weights = basix.make_quadrature(
        basix.CellType.hexahedron, determinant_degree(geometry_order)
    )
    gradients = np.asarray(element.tabulate(1, np.asarray(points)))[1:, :, :, 0]
    n_owned = mesh.topology.index_map(mesh.topology.dim).size_local
    nodes = mesh.geometry.x[mesh.geometry.dofmap[:n_owned]]
    volume = sum(
        weight * np.abs(np.linalg.det(np.einsum("dn,cnx->cdx", gradients[:, q], nodes))).sum()
        for q, weight in enumerate(np.asarray(weights))
    )
    return float(mesh.comm.allreduce(float(volume)))


def _open_checked_model(spec: MeshSpec, open_model: ExitStack) -> None:
    """Build and check `spec` in a gmsh model that `open_model` will close."""
    try:
        open_model.enter_context(gmsh_model())
        build_model(spec)
        check_model(spec)
    except MeshError:
        raise
    except Exception as error:  # gmsh raises a bare Exception
        raise MeshError(f"gmsh could not make the mesh: {error}") from error


def _check_distributed(spec: MeshSpec, mesh: Mesh, facet_tags: MeshTags) -> None:
    """Require that nothing was lost on the way; every rank sees the same sums, so all raise."""
    found = {Tag.BODY: mesh.topology.index_map(mesh.topology.dim).size_global}
    expected = {Tag.BODY: spec.n_cells, **spec.n_facets}
    for tag in spec.n_facets:
        found[tag] = count_facets(mesh, facet_tags, tag)
    for tag, number in expected.items():
        if found[tag] != number:
            name = tag.name.lower()
            raise MeshError(f"After distribution the {name} has {found[tag]} of {number} entities.")
    volume, expected_volume = volume_m3(mesh, spec.geometry_order), meshed_volume_m3(spec)
    # Summing n cells one after another may lose n units of round-off.
    round_off = spec.n_cells * np.finfo(float).eps
    if not abs(volume / expected_volume - 1) <= VOLUME_TOLERANCE + round_off:
        raise MeshError(
            f"After distribution the volume is {volume:.15g} m³, not {expected_volume:.15g} m³."
        )
