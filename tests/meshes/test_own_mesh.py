"""The user's own mesh: closed forms, the same bristle by other ways, and files that are refused."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import gmsh
import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI
from own_meshes import LENGTH, THIN, WIDE, box, moved, turned, wedge, write
from scipy.linalg import eigh
from solids import frequencies_hz

from bristle.meshes.distribute import own_to_dolfinx
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.meshes.hexahedra import build_model, gmsh_model
from bristle.meshes.own import OwnMesh, digest, own_mesh
from bristle.solver.bodies.reduced import reduce_solid
from bristle.solver.bodies.solid import SolidBody
from bristle.solver.bristle import Material
from bristle.solver.errors import InputError
from bristle.studies.inputs.config import DropInputs
from bristle.studies.inputs.sources import checked
from bristle.studies.running.cases import run_case
from bristle.studies.running.study import StudyInputs

SHORT = {"height_m": 0.01, "its_s": 1e-6, "until": "impact"}
NOTCH_M, NOTCH_Z = 8e-3, (6e-3, 14e-3)
NOTCH = [(side * THIN / 4, -WIDE, NOTCH_Z[0], side * THIN, 2 * WIDE, NOTCH_M) for side in (1, -1)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("own")


@pytest.fixture(scope="module")
def plain(folder) -> Path:
    return box(folder / "plain.msh")


def opened(path: Path) -> OwnMesh:
    return own_mesh(path, digest(path))


def solid_of(path: Path) -> SolidBody:
    domain, facets = own_to_dolfinx(opened(path), MPI.COMM_SELF)
    return SolidBody(domain, facets, int(Tag.TIP), Material(), 2)


def drop_of(**inputs):
    return run_case(checked(DropInputs, {**SHORT, **inputs}), MPI.COMM_SELF)[0]


NUMBERS = (
    *("cm_velocity_after_m_s", "contact_time_s", "peak_force_N", "max_penetration_m"),
    "impulse_N_s",
)


def numbers(result) -> np.ndarray:
    return np.array([getattr(result, name) for name in NUMBERS])


# --- the same bristle by other ways -------------------------------------------------------------


@pytest.mark.parametrize("tilt_deg", [0.0, 2.0])
def test_the_programs_own_mesh_comes_back_as_the_same_bristle(folder, tilt_deg):
    spec = MeshSpec(LENGTH, cells=(1, 2, 20))
    path = folder / "hexahedra.msh"
    with gmsh_model():
        build_model(spec)
        gmsh.write(str(path))
    lean = {"model": "reduced", "tilt_deg": tilt_deg}
    own = drop_of(mesh=str(path), **lean)
    made = drop_of(length_m=LENGTH, cells=(1, 2, 20), **lean)
    np.testing.assert_allclose(numbers(own), numbers(made), rtol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_a_mesh_knows_its_section_and_its_nodes(folder, plain, order):
    hexahedra = folder / "counted.msh"
    with gmsh_model():
        build_model(MeshSpec(LENGTH, cells=(1, 2, 20)))
        gmsh.write(str(hexahedra))
    for path in (plain, hexahedra):
        mesh = opened(path)
        for section in (mesh.tip_section, mesh.mean_section):
            assert (section.thickness_m, section.width_m) == pytest.approx((THIN, WIDE))
        domain, _ = own_to_dolfinx(mesh, MPI.COMM_SELF)
        space = fem.functionspace(domain, ("Lagrange", order))
        assert mesh.n_nodes(order) == space.dofmap.index_map.size_global


def test_straight_tetrahedra_converge_to_the_hexahedra(folder):
    """With the square of the distance between contact points, whose rule is linear on triangles;
    what the meshes differ by is less."""
    lean = {"tilt_deg": 1.0, "friction": 0.0, "deflection": "small", "model": "reduced"}
    path = box(folder / "coarse.msh", size_m=1.2e-3)
    errors = []
    for points in (9, 33):
        lean["contact_points"] = points
        made = drop_of(length_m=LENGTH, cells=(2, 4, 40), **lean)
        errors.append(np.abs(numbers(drop_of(mesh=str(path), **lean)) / numbers(made) - 1))
    assert errors[1].max() < 1e-3
    # force and penetration see single points as they come and go
    assert (errors[1] < errors[0] / np.array([16, 10, 10, 10, 16])).all()


def test_a_mesh_that_leans_is_one_that_is_tilted(folder):
    """The axes of a mesh that stands askew in its file are not principal, and z stays up."""
    upright = box(folder / "upright.msh", size_m=1.2e-3)
    askew = box(folder / "askew.msh", size_m=1.2e-3, change=moved(turned(3.0)))
    tilted = drop_of(mesh=str(upright), model="reduced", tilt_deg=3.0, until="rebound")
    own = drop_of(mesh=str(askew), model="reduced", until="rebound")
    np.testing.assert_allclose(numbers(own), numbers(tilted), rtol=1e-7)
    size = np.linalg.norm(tilted.velocity_after_m_s)
    difference = np.subtract(own.velocity_after_m_s, tilted.velocity_after_m_s)
    assert np.linalg.norm(difference) < 1e-7 * size
    assert own.cm_rebound_height_m == pytest.approx(tilted.cm_rebound_height_m, rel=1e-7)
    assert not opened(askew).straight
    assert opened(upright).straight


# --- closed forms -------------------------------------------------------------------------------


def test_a_wedges_mass_and_centre(folder):
    top = THIN / 4
    path = wedge(folder / "wedge.msh", top)
    own, solid = opened(path), solid_of(path)
    volume = 0.5 * (THIN + top) * WIDE * LENGTH
    centre = LENGTH / 3 * (THIN + 2 * top) / (THIN + top)
    assert own.volume_m3 == pytest.approx(volume, rel=1e-10)
    assert own.length_m == pytest.approx(LENGTH, rel=1e-12)
    np.testing.assert_allclose(own.centre_m, [0.0, 0.0, centre], atol=1e-10 * LENGTH)
    assert own.straight
    assert solid.mass_kg == pytest.approx(Material().density_kg_m3 * volume, rel=1e-10)
    np.testing.assert_allclose(solid.centre_m, own.centre_m, atol=1e-9 * LENGTH)
    assert own.mean_section.area_m2 * own.length_m == pytest.approx(volume, rel=1e-10)
    solid.close()


def test_a_bent_bristle_stands_in_its_principal_axes(folder):
    """x = κ z²/2: its axes, found from its nodes, make the solid's inertia diagonal."""
    kappa = 10.0

    def bent(x):
        return x + np.outer(0.5 * kappa * x[:, 2] ** 2, [1.0, 0.0, 0.0])

    path = box(folder / "bent.msh", size_m=1e-3, order=2, change=moved(bent))
    own, solid = opened(path), solid_of(path)
    # a shear along x keeps the volume and the heights
    assert own.volume_m3 == pytest.approx(THIN * WIDE * LENGTH, rel=1e-10)
    np.testing.assert_allclose(own.centre_m[2], LENGTH / 2, rtol=1e-10)
    # the mean of z² carries the centre
    assert own.centre_m[0] == pytest.approx(kappa * LENGTH**2 / 6, rel=1e-3)
    assert not own.straight
    motions = solid.rigid_motions()
    inertia = motions[:, 3:].T @ solid.mass(np.asfortranarray(motions[:, 3:]))
    products = inertia - np.diag(np.diag(inertia))
    assert np.abs(products).max() < 1e-9 * inertia.max()
    np.testing.assert_allclose(own.axes.T @ own.axes, np.eye(3), atol=1e-12)
    solid.close()
    result = drop_of(mesh=str(path), model="reduced")
    assert result.energy.closure_relative < 1e-2
    assert abs(result.velocity_after_m_s[0]) > 1e-3  # it is thrown aside


def test_a_notch_softens_bending_as_in_a_beam_of_two_stiffnesses(folder):
    frequencies = {}
    for name, cuts in (("whole", ()), ("notched", NOTCH)):
        solid = solid_of(box(folder / f"{name}.msh", cuts))
        modal = reduce_solid(solid, 1e12, leaning=True).modal
        found = np.sqrt(modal.omega2[modal.omega2 > 0.0].min()) / (2.0 * math.pi)
        near_hz = slowest_beam_hz(cuts)
        slow = frequencies_hz(solid.stiffness_matrix, solid.mass_matrix, near_hz, 2)
        assert found == pytest.approx(slow[np.abs(slow - near_hz).argmin()], rel=1e-5)
        assert found == pytest.approx(near_hz, rel=0.02)
        frequencies[name] = found
        solid.close()
    assert frequencies["notched"] < 0.8 * frequencies["whole"]


def slowest_beam_hz(cuts) -> float:
    """Of a free beam of Euler and Bernoulli, half as thin between the notches."""
    n, material = 200, Material()
    h = LENGTH / n
    stiff, mass = np.zeros((2 * n + 2,) * 2), np.zeros((2 * n + 2,) * 2)
    k = np.array(
        [
            [12, 6 * h, -12, 6 * h],
            [6 * h, 4 * h * h, -6 * h, 2 * h * h],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, 2 * h * h, -6 * h, 4 * h * h],
        ]
    )
    m = np.array(
        [
            [156, 22 * h, 54, -13 * h],
            [22 * h, 4 * h * h, 13 * h, -3 * h * h],
            [54, 13 * h, 156, -22 * h],
            [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
        ]
    )
    for i in range(n):
        cut = cuts and NOTCH_Z[0] < (i + 0.5) * h < NOTCH_Z[1]
        thin = THIN / 2 if cut else THIN
        own = slice(2 * i, 2 * i + 4)
        stiff[own, own] += material.youngs_Pa * WIDE * thin**3 / 12 / h**3 * k
        mass[own, own] += material.density_kg_m3 * WIDE * thin * h / 420 * m
    return math.sqrt(eigh(stiff, mass, eigvals_only=True)[2]) / (2.0 * math.pi)


# --- files and options --------------------------------------------------------------------------


def refusal(**inputs) -> str:
    with pytest.raises(InputError) as refused:
        checked(DropInputs, inputs)
    return str(refused.value)


def regroup(dim: int, entities) -> None:
    """Have the tip be other entities, or none."""
    gmsh.model.removePhysicalGroups(gmsh.model.getPhysicalGroups(2))
    gmsh.model.removePhysicalName("tip")
    if entities:
        gmsh.model.addPhysicalGroup(dim, entities, name="tip")


def inverted():
    """Carry a node of the upper end down through its cells."""
    gmsh.model.mesh.setNode(int(gmsh.model.mesh.getNodes(2, 6)[0][0]), [0.0, 0.0, LENGTH / 2], [])


SPOILT = {
    "no-tip": (lambda: regroup(2, []), "no physical group 'tip'.*'body'"),
    "top": (lambda: regroup(2, [6]), "'tip' begins at z = 0.02 m"),
    "all-over": (lambda: regroup(2, range(1, 7)), "'tip' has .* that face sideways or up"),
    "lines": (lambda: regroup(1, [1]), "'tip' must be of surfaces"),
    "inverted": (inverted, "turned inside out"),
    "millimetres": (moved(lambda x: 1e3 * x), "20 m long.*were they in mm"),
    "axis-x": (moved(lambda x: x[:, [2, 0, 1]]), "'tip'|longest along x"),
    "flat": (lambda: gmsh.model.mesh.clear([(3, 1)]), "no volume cells"),
}


@pytest.mark.parametrize("name", SPOILT)
def test_a_spoilt_mesh_is_refused_in_one_line_with_its_name(folder, name):
    change, message = SPOILT[name]
    path = box(folder / f"{name}.msh", size_m=1e-3, change=change)
    said = refusal(mesh=str(path))
    assert said.startswith(f"--mesh: {path}")
    assert "\n" not in said
    assert re.search(message, said), said


def test_a_body_in_two_parts_is_refused(folder):
    with gmsh_model():
        for z in (0.0, LENGTH):
            gmsh.model.occ.addBox(0.0, 0.0, 1.1 * z, THIN, WIDE, LENGTH)
        path = write(folder / "parts.msh", size_m=1e-3)
    assert "2 parts" in refusal(mesh=str(path))


def test_cells_of_two_kinds_are_refused(folder):
    with gmsh_model():
        build_model(MeshSpec(LENGTH, cells=(1, 1, 4)))
        volume = gmsh.model.addDiscreteEntity(3)
        gmsh.model.mesh.addElementsByType(volume, 4, [], [1, 2, 3, 5])
        gmsh.model.addPhysicalGroup(3, [volume], name="more")
        gmsh.write(str(folder / "mixed.msh"))
    said = refusal(mesh=str(folder / "mixed.msh"))
    assert "4 of Hexahedron 8" in said
    assert "1 of Tetrahedron 4" in said


def test_a_tip_within_the_body_is_refused(folder):
    with gmsh_model():
        for z in (0.0, LENGTH / 2):
            gmsh.model.occ.addBox(0.0, 0.0, z - LENGTH / 2, THIN, WIDE, LENGTH / 2)
        gmsh.model.occ.fragment([(3, 1)], [(3, 2)])
        path = write(folder / "within.msh", size_m=1e-3)
    assert "inside the body" in refusal(mesh=str(path))


def test_what_is_no_mesh_is_refused(folder):
    (folder / "text.msh").write_text("hello\n")
    (folder / "broken.msh").write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 2\n")
    assert "not a mesh of gmsh" in refusal(mesh=str(folder / "text.msh"))
    assert str(folder / "broken.msh") in refusal(mesh=str(folder / "broken.msh"))
    assert "No such file" in refusal(mesh=str(folder / "nowhere.msh"))


@pytest.mark.parametrize(
    "given",
    [
        {"length_m": 0.3365},
        {"thickness_m": 1e-3},
        {"diameter_m": 1e-3},
        {"cells": (1, 4, 337)},
        {"grading": 1.0},
        {"geometry_order": 1},
        {"tip_shape": "rounded:radius=1e-4"},
        {"model": "beam"},
        {"model": "analytic"},
    ],
)
def test_options_that_a_mesh_excludes_are_named(plain, given):
    (field,) = given
    option = "--" + field.removesuffix("_m").replace("_", "-")
    assert refusal(mesh=str(plain), **given).startswith(f"{option}: ")


def test_a_result_repeats_itself_until_the_file_changes(folder):
    path = box(folder / "kept.msh", size_m=1e-3)
    inputs = checked(DropInputs, {"mesh": str(path), **SHORT})
    assert inputs.model == "reduced"
    kept = json.loads(inputs.model_dump_json())
    assert kept["mesh"] == {"path": str(path), "sha256": digest(path)}
    given = {key: value for key, value in kept.items() if value is not None}
    assert checked(DropInputs, given) == inputs
    path.write_text(path.read_text() + "\n")
    with pytest.raises(InputError, match=r"--mesh: .*kept\.msh has changed"):
        checked(DropInputs, given)


def test_a_sweep_of_a_mesh_is_of_the_reduced_solid(plain):
    cases = checked(StudyInputs, {"mesh": str(plain), "kn_N_m": (2e6,)}).cases()
    assert {case.model for case in cases} == {"reduced"}
    assert len({case.mesh for case in cases}) == 1
