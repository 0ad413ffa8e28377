"""A bristle's mesh on the ranks of a dolfinx run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

import basix
import gmsh
import numpy as np
from dolfinx.io import gmshio
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI

from .check import VOLUME_TOLERANCE, MeshError, check_model, determinant_degree, meshed_volume_m3
from .collective import run_on_one_rank
from .geometry import MeshSpec, Tag
from .hexahedra import build_model, gmsh_model
from .own import OwnMesh, opened, regroup

BUILDER_RANK = 0


def to_dolfinx(
    spec: MeshSpec,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    partitioner: Callable | None = None,
) -> tuple[Mesh, MeshTags, MeshTags]:
    """Build the mesh of `spec` on rank 0 and distribute it over `comm`; collective.

    Returns mesh, cell tags and facet tags: coordinates in metres, geometry of `geometry_order`,
    both tags with the values of `Tag`, e.g. ``facet_tags.find(Tag.TIP)``. `partitioner` is that of
    `dolfinx.mesh.create_mesh`, by default dolfinx' own, without ghost cells. Raises MeshError, with
    the same message on all ranks, if gmsh fails or the mesh does not match `spec`.
    """

    def open_model(stack: ExitStack) -> None:
        try:
            stack.enter_context(gmsh_model())
            build_model(spec)
            check_model(spec)
        except MeshError:
            raise
        except Exception as error:  # gmsh raises a bare Exception
            raise MeshError(f"gmsh could not make the mesh: {error}") from error

    expected = {Tag.BODY: spec.n_cells, **spec.n_facets}
    return distribute(comm, open_model, expected, meshed_volume_m3(spec), partitioner)


def own_to_dolfinx(own: OwnMesh, comm: MPI.Intracomm) -> tuple[Mesh, MeshTags]:
    """The user's mesh in the body's principal axes, and its facets with `Tag.TIP`; collective.

    Raises MeshError on all ranks.
    """

    def open_model(stack: ExitStack) -> None:
        stack.enter_context(opened(own.path, own.sha256))
        regroup()

    expected = {Tag.BODY: own.counts[3], Tag.TIP: own.n_tip_facets}
    mesh, _, facets = distribute(comm, open_model, expected, own.volume_m3)
    if not np.array_equal(own.axes, np.eye(3)):
        mesh.geometry.x[:] = mesh.geometry.x @ own.axes
    return mesh, facets


def distribute(
    comm: MPI.Intracomm,
    open_model: Callable[[ExitStack], None],
    expected: dict[Tag, int],
    expected_m3: float,
    partitioner: Callable | None = None,
) -> tuple[Mesh, MeshTags, MeshTags]:
    """Distribute the gmsh model that ``open_model`` opens on rank 0; collective.

    The numbers of cells and facets by group, ``expected``, and the volume ``expected_m3`` are
    checked afterwards. Returns and raises as `to_dolfinx`.
    """
    with ExitStack() as stack:
        run_on_one_rank(comm, lambda: open_model(stack), BUILDER_RANK)
        mesh, cell_tags, facet_tags = gmshio.model_to_mesh(
            gmsh.model if comm.rank == BUILDER_RANK else None,
            comm,
            BUILDER_RANK,
            gdim=3,
            partitioner=partitioner,
        )
    mesh.name, cell_tags.name, facet_tags.name = "bristle", "cell_tags", "facet_tags"
    _check_distributed(mesh, facet_tags, expected, expected_m3)
    return mesh, cell_tags, facet_tags


def count_facets(mesh: Mesh, facet_tags: MeshTags, tag: Tag) -> int:
    """Return how many facets of all ranks together carry the tag; collective."""
    n_owned = mesh.topology.index_map(mesh.topology.dim - 1).size_local
    return mesh.comm.allreduce(int(np.count_nonzero(facet_tags.find(tag) < n_owned)))


def coordinate_element(mesh: Mesh) -> basix.finite_element.FiniteElement:
    """The element that maps the reference cell to the cells of a mesh."""
    map_, cell = mesh.geometry.cmap, basix.CellType[mesh.topology.cell_type.name]
    variant = basix.LagrangeVariant(map_.variant)
    return basix.create_element(basix.ElementFamily.P, cell, map_.degree, variant)


def volume_m3(mesh: Mesh) -> float:
    """Return the volume of all ranks' cells, m³; collective. Needs no form to be compiled."""
    element = coordinate_element(mesh)
    degree = determinant_degree(element.degree)
    points, weights = basix.make_quadrature(element.cell_type, degree)
    gradients = np.asarray(element.tabulate(1, np.asarray(points)))[1:, :, :, 0]
    n_owned = mesh.topology.index_map(mesh.topology.dim).size_local
    nodes = mesh.geometry.x[mesh.geometry.dofmap[:n_owned]]
    volume = sum(
        weight * np.abs(np.linalg.det(np.einsum("dn,cnx->cdx", gradients[:, q], nodes))).sum()
        for q, weight in enumerate(np.asarray(weights))
    )
    return float(mesh.comm.allreduce(float(volume)))


def _check_distributed(
    mesh: Mesh, facet_tags: MeshTags, expected: dict[Tag, int], expected_m3: float
) -> None:
    """Require that nothing was lost; every rank sees the same sums, so all raise."""
    n_cells = mesh.topology.index_map(mesh.topology.dim).size_global
    for tag, number in expected.items():
        found = n_cells if tag is Tag.BODY else count_facets(mesh, facet_tags, tag)
        if found != number:
            name = tag.name.lower()
            raise MeshError(f"After distribution the {name} has {found} of {number} entities.")
    volume = volume_m3(mesh)
    # Summing n cells in sequence may lose n units of round-off.
    round_off = n_cells * np.finfo(float).eps
    if not abs(volume / expected_m3 - 1) <= VOLUME_TOLERANCE + round_off:
        raise MeshError(
            f"After distribution the volume is {volume:.15g} m³, not {expected_m3:.15g} m³."
        )
