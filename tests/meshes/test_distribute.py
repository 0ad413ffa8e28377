"""The mesh that dolfinx gets is the same body on any number of ranks."""

import math

import dolfinx
import numpy as np
import pytest
import ufl
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from bristle.meshes import distribute
from bristle.meshes.check import MeshError, meshed_volume_m3
from bristle.meshes.collective import run_on_one_rank
from bristle.meshes.distribute import count_facets, to_dolfinx, volume_m3
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.meshes.section import Circle, Rectangle

COMM = MPI.COMM_WORLD
RECTANGLE = Rectangle(0.5e-3, 2.08e-3)
WIRE = Circle(1.2e-3)
BOTH_SECTIONS = pytest.mark.parametrize("section", [RECTANGLE, WIRE], ids=["rectangle", "wire"])
BOTH_ORDERS = pytest.mark.parametrize("order", [1, 2])


def spec_of(section, cells=(2, 3, 6), order=1, grading=1.0, length_m=0.02):
    return MeshSpec(length_m, section, cells, order, grading)


class Integrals:
    """Integrals over the parts of a distributed mesh, by quadrature that is exact for them."""

    def __init__(self, spec, comm=COMM, **options):
        self.mesh, self.cell_tags, self.facet_tags = to_dolfinx(spec, comm, **options)
        # Cubic polynomials of a second-order geometry, times its determinant.
        metadata = {"quadrature_degree": 3 * spec.geometry_order + 5}
        self.dx = ufl.Measure("dx", self.mesh, subdomain_data=self.cell_tags, metadata=metadata)
        self.ds = ufl.Measure("ds", self.mesh, subdomain_data=self.facet_tags, metadata=metadata)
        self.x = ufl.SpatialCoordinate(self.mesh)
        self.n = ufl.FacetNormal(self.mesh)

    def __call__(self, integrand):
        form = dolfinx.fem.form(integrand)
        return self.mesh.comm.allreduce(dolfinx.fem.assemble_scalar(form))


@pytest.mark.parametrize("grading", [1.0, 5.0])
@pytest.mark.parametrize("cells", [(1, 1, 1), (1, 4, 9), (3, 2, 5)])
@BOTH_ORDERS
@BOTH_SECTIONS
def test_counts_and_volume(section, order, cells, grading):
    spec = spec_of(section, cells, order, grading)
    mesh, cell_tags, facet_tags = to_dolfinx(spec, COMM)
    assert mesh.topology.index_map(3).size_global == spec.n_cells
    assert COMM.allreduce(len(cell_tags.find(Tag.BODY))) == spec.n_cells
    assert {tag: count_facets(mesh, facet_tags, tag) for tag in spec.n_facets} == spec.n_facets
    assert mesh.geometry.cmap.degree == order
    assert volume_m3(mesh) == pytest.approx(meshed_volume_m3(spec), rel=1e-12)


def moments_of(section):
    return section.area_m2, section.second_moment_x_m4, section.second_moment_y_m4


@BOTH_ORDERS
def test_polynomials_over_the_rectangle_are_exact(order):
    over = Integrals(spec_of(RECTANGLE, order=order, grading=3.0))
    (x, y, z), length = over.x, 0.02
    area, ixx, iyy = moments_of(RECTANGLE)
    tip, body = over.ds(Tag.TIP), over.dx(Tag.BODY)
    one = dolfinx.fem.Constant(over.mesh, 1.0)
    assert over(one * tip) == pytest.approx(area, rel=1e-12)
    assert over(x**2 * tip) == pytest.approx(ixx, rel=1e-12)
    assert over(y**2 * tip) == pytest.approx(iyy, rel=1e-12)
    assert over(x * y * tip) == pytest.approx(0, abs=1e-12 * iyy)
    assert over(z * body) == pytest.approx(area * length**2 / 2, rel=1e-12)
    assert over(x**2 * z * body) == pytest.approx(ixx * length**2 / 2, rel=1e-12)
    assert over(y**2 * z**3 * body) == pytest.approx(iyy * length**4 / 4, rel=1e-12)
    assert over(x * body) == pytest.approx(0, abs=1e-12 * area * length * 1e-3)


@pytest.mark.parametrize(("order", "rate"), [(1, 2), (2, 4)])
def test_moments_of_the_wires_tip_converge_at_their_rate(order, rate):
    moments = moments_of(WIRE)
    errors = []
    for n in (2, 4, 8):
        over = Integrals(spec_of(WIRE, (n, n, 2), order))
        x, y, _ = over.x
        found = [over(f * over.ds(Tag.TIP)) for f in (1 + 0 * x, x**2, y**2)]
        errors.append(np.abs(np.array(found) / moments - 1))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    # The errors go on with a² = (π / 4n)²: 0.15 between the coarsest two, 0.04 between the others.
    assert rates[0] == pytest.approx([rate] * 3, abs=0.15)
    assert rates[1] == pytest.approx([rate] * 3, abs=0.04)


@BOTH_ORDERS
@BOTH_SECTIONS
def test_parts_of_the_surface_lie_where_their_names_say(section, order):
    spec = spec_of(section, order=order)
    over = Integrals(spec)
    z, n = over.x[2], over.n
    volume = meshed_volume_m3(spec)
    area = volume / spec.length_m
    down = ufl.as_vector([0.0, 0.0, -1.0])

    def squared(v):
        return ufl.inner(v, v)

    tip, top, side = over.ds(Tag.TIP), over.ds(Tag.TOP), over.ds(Tag.SIDE)
    assert over(squared(n - down) * tip) == pytest.approx(0, abs=1e-20 * area)
    assert over(squared(n + down) * top) == pytest.approx(0, abs=1e-20 * area)
    # gmsh finds the middle of an arc to about 1e-9 of it, not to round-off.
    tilt = 1e-10 if section is RECTANGLE else 1e-8
    assert over(n[2] ** 2 * side) == pytest.approx(0, abs=tilt**2 * area)
    assert over(z**2 * tip) == pytest.approx(0, abs=1e-24 * area)
    assert over((z - spec.length_m) ** 2 * top) == pytest.approx(0, abs=1e-24 * area)
    # Divergence theorem, of x and of the constant.
    assert over(ufl.dot(over.x, n) * over.ds) == pytest.approx(3 * volume, rel=1e-11)
    assert over(ufl.dot(over.x, n) * side) == pytest.approx(2 * volume, rel=1e-11)
    perimeter = 2 * (0.5e-3 + 2.08e-3) if section is RECTANGLE else math.pi * 1.2e-3
    # A polygon of 8 sides is shorter by 2.6 %; parabolas are nearer.
    tolerance = 1e-12 if section is RECTANGLE else {1: 0.03, 2: 1e-3}[order]
    side_area = over((1 + 0 * z) * side)
    assert side_area == pytest.approx(perimeter * spec.length_m, rel=tolerance)


@BOTH_ORDERS
@BOTH_SECTIONS
def test_all_ranks_together_integrate_as_one_alone(section, order):
    spec = spec_of(section, (2, 2, 23), order, grading=4.0)
    results = []
    for comm in (COMM, MPI.COMM_SELF):
        over = Integrals(spec, comm)
        x, y, z = over.x
        wave = ufl.cos(200 * z + 700 * x) * (1 + 300 * y)
        results.append(
            [over(wave * m) for m in (over.dx, over.ds(Tag.TIP), over.ds(Tag.TOP), over.ds)]
        )
    assert results[0] == pytest.approx(results[1], rel=1e-11)


def test_ghost_cells_count_nothing_twice():
    spec = spec_of(RECTANGLE, (1, 2, 11))
    partitioner = dolfinx.mesh.create_cell_partitioner(dolfinx.mesh.GhostMode.shared_facet)
    over = Integrals(spec, partitioner=partitioner)
    assert count_facets(over.mesh, over.facet_tags, Tag.SIDE) == 6 * 11
    assert over((1 + 0 * over.x[0]) * over.ds(Tag.TIP)) == pytest.approx(RECTANGLE.area_m2)


@settings(max_examples=12, deadline=None, derandomize=True, database=None)
@given(
    cells=st.tuples(st.integers(1, 3), st.integers(1, 4), st.integers(1, 15)),
    order=st.sampled_from([1, 2]),
    grading=st.floats(0.1, 10.0),
    section=st.sampled_from([RECTANGLE, WIRE]),
)
def test_any_division_arrives_whole(cells, order, grading, section):
    spec = spec_of(section, cells, order, grading)
    mesh, _, facet_tags = to_dolfinx(spec, COMM)
    assert count_facets(mesh, facet_tags, Tag.TIP) == spec.n_section_cells
    assert volume_m3(mesh) == pytest.approx(meshed_volume_m3(spec), rel=1e-12)


def test_failure_of_the_builder_reaches_every_rank(monkeypatch):
    def fail(spec):
        raise Exception("no such luck")  # gmsh raises nothing more particular

    monkeypatch.setattr(distribute, "build_model", fail)
    with pytest.raises(MeshError, match="gmsh could not make the mesh: no such luck"):
        to_dolfinx(spec_of(RECTANGLE), COMM)
    monkeypatch.undo()
    assert to_dolfinx(spec_of(RECTANGLE), COMM)[0].comm.size == COMM.size


def test_unsound_mesh_is_refused_on_every_rank(monkeypatch):
    build = distribute.build_model
    monkeypatch.setattr(distribute, "build_model", lambda _: build(spec_of(RECTANGLE, (1, 1, 1))))
    with pytest.raises(MeshError, match="1 hexahedra instead of 36"):
        to_dolfinx(spec_of(RECTANGLE), COMM)


def test_loss_on_the_way_is_noticed(monkeypatch):
    monkeypatch.setattr(distribute, "check_model", lambda _: None)
    build = distribute.build_model
    monkeypatch.setattr(distribute, "build_model", lambda _: build(spec_of(RECTANGLE, (1, 1, 6))))
    with pytest.raises(MeshError, match="body has 6 of 12 entities"):
        to_dolfinx(spec_of(RECTANGLE, (1, 2, 6)), COMM)
    with pytest.raises(MeshError, match="side has 24 of 26 facets|tip has 1 of 2"):
        to_dolfinx(spec_of(RECTANGLE, (1, 2, 3)), COMM)
    with pytest.raises(MeshError, match="After distribution the volume is"):
        to_dolfinx(spec_of(RECTANGLE, (1, 1, 6), length_m=0.0201), COMM)


class Unsendable(Exception):
    """Its unpickling fails, as of any error whose constructor wants more than a message."""

    def __init__(self, code, message):
        super().__init__(message)


class Reworded(Exception):
    """Its unpickling would prefix the message a second time."""

    def __init__(self, name):
        super().__init__(f"no {name}")


@pytest.mark.parametrize(
    "error", [KeyError("k"), OSError(28, "No space"), Unsendable(1, "odd"), Reworded("luck")]
)
def test_error_of_one_rank_is_raised_by_all(error):
    def fail():
        raise error

    expected = type(error)
    if COMM.rank != 0 and isinstance(error, Unsendable | Reworded):
        expected = RuntimeError
    with pytest.raises(expected) as raised:
        run_on_one_rank(COMM, fail)
    assert str(raised.value) == str(error)


def test_result_of_one_rank_is_given_to_all():
    last = COMM.size - 1
    assert run_on_one_rank(COMM, lambda: {"rank": COMM.rank}, rank=last) == {"rank": last}
