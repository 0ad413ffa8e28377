"""Contact points of a solid's tip: quadrature points of its facets, as rows over the unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import basix
import numpy as np
import ufl
from dolfinx import fem, la, mesh
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ...meshes.collective import run_on_one_rank
from ...meshes.distribute import coordinate_element
from ...meshes.section import gauss_lobatto
from ..arrays import Array
from ..bristle import CONTACT_POINTS
from ..errors import ComputationError
from ..form_cache import expression
from ..forms import Expr, StepForms, TipMeasure
from .base import ContactPoints

SAME_POINT_M = 1e-9
ALIGNED = 1e-9
# A tangent omits singular values of the traction's change below this share of the largest.
FAINT = 1e-6

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Rule:
    """A quadrature rule on the reference facet, and this rank's facets of the tip that use it.

    ``points`` (m, 2), ``weights`` (m,) that sum to the reference facet's area; ``entities`` (2 k,)
    are cell and local facet of each of the facets.
    """

    name: str
    points: Array
    weights: Array
    entities: NDArray[np.int32]

    @property
    def metadata(self) -> dict[str, object]:
        """The rule as metadata of a UFL measure."""
        return {
            "quadrature_rule": "custom",
            "called": self.name,  # UFL distinguishes long lists by their ends alone
            "quadrature_points": self.points,
            "quadrature_weights": self.weights,
        }


@dataclass(frozen=True)
class FacetPoints:
    """A rank's contact points, facet by facet.

    Each has a position (p, 3) and an area (p,), the ``nodes`` (p, a) of its facet with their
    ``shares`` (p, a) of its displacement, and rows ``traction_Pa`` (p, 3, c) over the unknowns
    ``columns`` (p, c) of its cell. Nodes and unknowns have global numbers.
    """

    places_m: Array
    areas_m2: Array
    nodes: Index
    shares: Array
    columns: Index
    traction_Pa: Array

    @classmethod
    def joined(cls, parts: list[FacetPoints]) -> FacetPoints:
        """The ``parts`` concatenated."""
        names = cls.__dataclass_fields__
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True)
class TipFacets:
    """The tip's facets with the rules whose quadrature points are its contact points.

    Point p of this rank, facet by facet and rule by rule, belongs to contact point ``index`` (p,)
    with the weight ``shares`` (p,); the weights at a contact point sum to one.
    """

    rules: list[Rule]
    measure: TipMeasure
    index: NDArray[np.intp]
    shares: Array


def tip_contact(
    space: fem.FunctionSpace,
    facets: NDArray[np.int32],
    traction: Callable[[Expr], Expr],
    centre_m: Array,
    points: int = CONTACT_POINTS,
) -> tuple[ContactPoints, TipFacets]:
    """Contact points of the tip, and the facets whose quadrature points they are.

    On quadrilaterals they are Gauss-Lobatto points, on triangles the corners of equal small
    triangles: at least ``points`` across each side of the section, edges and corners of the face
    included. Points that facets share are merged, their traction being the mean weighted by area.
    ``traction`` gives the force per area for a displacement; ``centre_m`` (3,) is the centre of
    mass. Collective; raises ComputationError if no rank has a facet of the tip.
    """
    rules, comm = tip_rules(space, facets, points), space.mesh.comm
    own = FacetPoints.joined([_facet_points(space, rule, traction) for rule in rules])
    parts = comm.allgather(own)
    found = FacetPoints.joined(parts)
    if not len(found.areas_m2):
        raise ComputationError("no facet of the mesh carries the tip's tag")
    keys = np.round(found.places_m / SAME_POINT_M).astype(np.int64)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    index = index.ravel()
    areas = np.bincount(index, weights=found.areas_m2)
    total, shares = float(areas.sum()), found.areas_m2 / areas[index]
    nodes = np.unique(found.nodes)
    contact = ContactPoints(
        coordinates=_node_rows(space, nodes),
        support=_unknowns(np.searchsorted(nodes, found.nodes[first])),
        shapes=np.einsum("pa,kl->pkal", found.shares[first], np.eye(3)).reshape(len(first), 3, -1),
        traction=_traction_rows(space, found, index, shares * total),
        weights=areas / total,
        places_m=found.places_m[first] - centre_m,
        comm=comm,
    )
    start = sum(len(part.areas_m2) for part in parts[: comm.rank])
    mine = slice(start, start + len(own.areas_m2))
    return contact, TipFacets(rules, _measure(space.mesh, rules, total), index[mine], shares[mine])


def tip_rules(space: fem.FunctionSpace, facets: NDArray[np.int32], points: int) -> list[Rule]:
    """The rules of the tip's facets, the same on all ranks, with this rank's facets."""
    domain, tdim = space.mesh, space.mesh.topology.dim
    domain.topology.create_connectivity(tdim - 1, tdim)
    domain.topology.create_connectivity(tdim, tdim - 1)
    exterior = fem.IntegralType.exterior_facet
    found = fem.compute_integration_domains(exterior, domain.topology, facets, tdim - 1)
    entities = np.asarray(found, dtype=np.int32).reshape(-1, 2)
    degree: int = space.element.basix_element.degree
    if domain.topology.cell_type is mesh.CellType.tetrahedron:
        counts = _divisions(domain, len(entities), degree, points)
    else:
        counts = _points_along(domain, entities, degree, points)
    every = sorted({count for part in domain.comm.allgather(counts) for count in part})
    rules = []
    for count in every:
        mine = np.array([i for i, own in enumerate(counts) if own == count], dtype=np.int64)
        places, weights = _triangle_rule(*count) if len(count) == 1 else _square_rule(*count)
        rules.append(Rule(" x ".join(map(str, count)), places, weights, entities[mine].ravel()))
    return rules


def _square_rule(along: int, across: int) -> tuple[Array, Array]:
    """Gauss-Lobatto rule on the unit square: ``along`` by ``across`` points."""
    (p, wp), (q, wq) = gauss_lobatto(along), gauss_lobatto(across)
    points = 0.5 * (np.stack(np.meshgrid(p, q, indexing="ij"), -1).reshape(-1, 2) + 1.0)
    return points, 0.25 * np.outer(wp, wq).ravel()


def _triangle_rule(divisions: int) -> tuple[Array, Array]:
    """The corners of small triangles, with each side divided into ``divisions``; exact for
    functions that are linear on each of them."""
    lattice = [(i, j) for i in range(divisions + 1) for j in range(divisions + 1 - i)]
    number = {corner: k for k, corner in enumerate(lattice)}
    weights = np.zeros(len(lattice))
    for i, j in lattice:
        for small in (((i, j), (i + 1, j), (i, j + 1)), ((i + 1, j), (i, j + 1), (i + 1, j + 1))):
            if all(corner in number for corner in small):
                weights[[number[corner] for corner in small]] += 1.0 / 6.0 / divisions**2
    return np.array(lattice) / divisions, weights


def _on_cell(domain: mesh.Mesh, local: int, points: Array) -> tuple[Array, Array]:
    """Positions (m, 3) on the reference cell of ``points`` (m, 2) on a facet, and its tangents."""
    kind = basix.CellType[domain.topology.cell_type.name]
    corners = np.asarray(basix.geometry(kind))[basix.topology(kind)[2][local]]
    tangents = corners[1:3] - corners[0]
    return corners[0] + points @ tangents, tangents


def _divisions(domain: mesh.Mesh, own: int, degree: int, points: int) -> list[tuple[int, ...]]:
    """Number of divisions of each triangle's sides that puts the face's nodes among the corners."""
    across = np.sqrt(0.5 * domain.comm.allreduce(own))
    wanted = int(np.ceil((points - 1) / max(across, 1.0) - 1e-9))
    return [(max(degree, -(-wanted // degree) * degree),)] * own


def _points_along(
    domain: mesh.Mesh, entities: NDArray[np.int32], degree: int, points: int
) -> list[tuple[int, ...]]:
    """Number of points along each quadrilateral's sides: odd, so that nodes are among them.

    On a grid of equal facets each direction has its own number. Other faces take the root of the
    number of facets as the number across.
    """
    comm, geometry = domain.comm, domain.geometry
    element = coordinate_element(domain)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    places = np.empty((len(entities), 4, 2))
    for i in range(len(entities)):
        on_cell, _ = _on_cell(domain, int(entities[i, 1]), corners)
        shapes = np.asarray(element.tabulate(0, on_cell))[0, ..., 0]
        places[i] = (shapes @ geometry.x[geometry.dofmap[entities[i, 0]]])[:, :2]
    low = comm.allreduce(places.min(axis=(0, 1), initial=np.inf), np.minimum)
    high = comm.allreduce(places.max(axis=(0, 1), initial=-np.inf), np.maximum)
    count = comm.allreduce(len(entities))
    box = np.abs(high - low)
    sides = places[:, 1:3] - places[:, :1]
    aligned = bool(np.all(np.abs(sides).min(axis=2) < ALIGNED * box.max(initial=0.0)))
    gridded = comm.allreduce(aligned, lambda a, b: a and b)

    def odd(across: float) -> int:
        wanted = max(degree + 1, int(np.ceil((points - 1) / across - 1e-9)) + 1)
        return wanted + (wanted + 1) % 2

    if not gridded:
        return [(odd(np.sqrt(count)),) * 2] * len(entities)
    return [
        tuple(odd(float(np.round(box @ np.abs(side) / (side @ side)))) for side in pair)
        for pair in sides
    ]


def _facet_points(
    space: fem.FunctionSpace, rule: Rule, traction: Callable[[Expr], Expr]
) -> FacetPoints:
    """This rank's points of a rule."""
    domain, element = space.mesh, space.element.basix_element
    cells, local = rule.entities[::2], rule.entities[1::2]
    k, m = len(cells), len(rule.points)
    size = len(_facet_nodes(element, 0))
    places, areas = np.empty((k, m, 3)), np.empty((k, m))
    shares, nodes = np.empty((k, m, size)), np.empty((k, size), dtype=np.int64)
    for i in range(k):
        on_cell, tangents = _on_cell(domain, local[i], rule.points)
        shapes = np.asarray(coordinate_element(domain).tabulate(1, on_cell))[..., 0]
        x = domain.geometry.x[domain.geometry.dofmap[cells[i]]]
        places[i] = shapes[0] @ x
        sides = np.einsum("td,dma,ax->mtx", tangents, shapes[1:], x)
        areas[i] = rule.weights * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        own = _facet_nodes(element, local[i])
        nodes[i] = _as_all_number(space, space.dofmap.cell_dofs(cells[i])[own])
        shares[i] = np.asarray(element.tabulate(0, on_cell))[0, :, own, 0].T
    columns = _unknowns(_as_all_number(space, space.dofmap.list[cells]))
    values = expression(traction(ufl.TrialFunction(space)), rule.points).eval(domain, rule.entities)
    return FacetPoints(
        places.reshape(-1, 3),
        areas.ravel(),
        np.repeat(nodes, m, axis=0),
        shares.reshape(k * m, size),
        np.repeat(columns, m, axis=0),
        values.reshape(k * m, 3, columns.shape[1]),
    )


def _facet_nodes(element: basix.finite_element.FiniteElement, local: int) -> NDArray[np.intp]:
    return np.asarray(element.entity_closure_dofs[2][local], dtype=np.intp)


def _measure(domain: mesh.Mesh, rules: list[Rule], area_m2: float) -> TipMeasure:
    """The tip with each facet's own rule."""
    parts = [(i, rule.entities) for i, rule in enumerate(rules)]
    measures = (
        ufl.Measure("ds", domain=domain, subdomain_data=parts, metadata=rule.metadata)(i)
        for i, rule in enumerate(rules)
    )
    return TipMeasure(tuple(measures), area_m2)


def _local_columns(space: fem.FunctionSpace) -> tuple[int, int]:
    """First and last global unknown of this rank."""
    block = space.dofmap.index_map_bs
    first, last = space.dofmap.index_map.local_range
    return block * first, block * last


def _as_all_number(space: fem.FunctionSpace, nodes: NDArray[np.int32]) -> Index:
    """Global numbers of this rank's ``nodes``."""
    whole = space.dofmap.index_map.local_to_global(nodes.ravel())
    return np.asarray(whole.reshape(nodes.shape))


def _unknowns(nodes: NDArray[np.integer]) -> Index:
    """The unknowns (k, 3 a) of ``nodes`` (k, a), in the same numbering; k may be zero."""
    return (3 * nodes[..., None] + np.arange(3)).reshape(len(nodes), 3 * nodes.shape[1])


def _node_rows(space: fem.FunctionSpace, nodes: Index) -> csr_matrix:
    """The displacements of ``nodes`` as rows over this rank's unknowns."""
    column = _unknowns(nodes[:, None]).ravel()
    row = np.arange(len(column))
    return _own_columns(space, np.ones(len(column)), row, column, len(column))


def _traction_rows(
    space: fem.FunctionSpace, found: FacetPoints, index: NDArray[np.intp], shares: Array
) -> csr_matrix:
    """Rows of traction, summed by ``shares`` per point and axis (3 n, unknowns of this rank)."""
    row = np.broadcast_to((3 * index[:, None] + np.arange(3))[..., None], found.traction_Pa.shape)
    column = np.broadcast_to(found.columns[:, None], found.traction_Pa.shape)
    value = shares[:, None, None] * found.traction_Pa
    return _own_columns(space, value, row, column, 3 * (int(index.max()) + 1))


def _own_columns(
    space: fem.FunctionSpace, value: Array, row: Index, column: Index, n_rows: int
) -> csr_matrix:
    """Matrix with these values in these rows and columns, as far as the columns are unknowns of
    this rank; duplicates add up."""
    first, last = _local_columns(space)
    keep = (column >= first) & (column < last) & (value != 0.0)
    return csr_matrix((value[keep], (row[keep], column[keep] - first)), (n_rows, last - first))


class TipTractions:
    """Section area times the traction at the contact points, for the state that ``forms`` hold.

    Collective, as are all methods.
    """

    def __init__(self, tip: TipFacets, forms: StepForms, n_points: int) -> None:
        self._tip, self._n, space = tip, n_points, forms.u.function_space
        self._domain, self._comm = space.mesh, space.mesh.comm
        parts = {
            "start": forms.start_traction(),
            "end": forms.end_traction(),
            "mean": forms.mean_traction(),
            "viscous": forms.viscous_traction(),
            "change": forms.traction_change(forms.trial),
        }
        self._tables = {
            name: [expression(part, rule.points) for rule in tip.rules]
            for name, part in parts.items()
        }
        self._load = la.vector(space.dofmap.index_map, 3)
        cells = np.concatenate([np.repeat(r.entities[::2], len(r.points)) for r in tip.rules])
        nodes = space.dofmap.list[cells]
        self._unknowns = _unknowns(nodes)
        first, last = _local_columns(space)
        self._own = last - first
        columns = _unknowns(_as_all_number(space, nodes))
        self._columns = np.unique(np.concatenate(self._comm.allgather(np.unique(columns))))
        self._place = np.searchsorted(self._columns, columns)
        self._owned = np.flatnonzero((self._columns >= first) & (self._columns < last))
        self._owned_local = self._columns[self._owned] - first

    def start(self) -> Array:
        """At the start of the step (n, 3), viscous part included."""
        return self._at_points("start")

    def end(self) -> Array:
        """At the end of the step (n, 3), viscous part included."""
        return self._at_points("end")

    def mean(self) -> Array:
        """The tractions that do the work over the step (n, 3)."""
        return self._at_points("mean")

    def viscous(self) -> Array:
        """The viscous part of `mean` (n, 3)."""
        return self._at_points("viscous")

    def pushed(self, force: Array) -> Array:
        """Loads (n_local,) with the work of ``force`` (n, 3) on a motion's change of traction."""
        tip = self._tip
        own = tip.measure.area_m2 * tip.shares[:, None] * force[tip.index]
        self._load.array[:] = 0.0
        np.add.at(self._load.array, self._unknowns, np.einsum("pk,pkc->pc", own, self._changes()))
        self._load.scatter_reverse(la.InsertMode.add)
        return np.array(self._load.array[: self._own])

    def compressed(self) -> tuple[Array, Array]:
        """``left`` (3 n, r) and ``right`` (r, n_local), whose product approximates the derivative
        of the tractions by the motion, without singular values below `FAINT`."""
        tip = self._tip
        rows: Array = np.zeros((self._n, 3, len(self._columns)))
        scaled = tip.measure.area_m2 * tip.shares[:, None, None] * self._changes()
        index = (tip.index[:, None, None], np.arange(3)[:, None], self._place[:, None])
        np.add.at(rows, index, scaled)
        rows = self._comm.allreduce(rows).reshape(3 * self._n, -1)
        # the number of significant ones may depend on rounding, which differs between machines
        left, size, right = run_on_one_rank(
            self._comm, lambda: tuple(np.linalg.svd(rows, full_matrices=False))
        )
        significant = size > FAINT * size[0]
        own = np.zeros((int(significant.sum()), self._own))
        own[:, self._owned_local] = right[significant][:, self._owned]
        return left[:, significant] * size[significant], own

    def _changes(self) -> Array:
        """Rows (p, 3, unknowns of a cell): derivative of the tractions of this rank's points."""
        return self._eval("change").reshape(len(self._place), 3, self._place.shape[1])

    def _at_points(self, name: str) -> Array:
        tip = self._tip
        total = np.zeros((self._n, 3))
        np.add.at(total, tip.index, tip.shares[:, None] * self._eval(name).reshape(-1, 3))
        return np.asarray(tip.measure.area_m2 * self._comm.allreduce(total))

    def _eval(self, name: str) -> Array:
        """Values rule by rule, facet by facet, flat."""
        return np.concatenate(
            [
                table.eval(self._domain, rule.entities).ravel()
                for table, rule in zip(self._tables[name], self._tip.rules, strict=True)
            ]
        )
