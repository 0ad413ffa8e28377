"""Fields of a marched solid hold what the drop's own numbers say; on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import bristle
from bristle.meshes.geometry import Tag
from bristle.solver import paper
from bristle.solver.solid_fields import FieldRecorder

COMM = MPI.COMM_WORLD
KN, LENGTH, AREA = 2e6, 0.05, paper.WIDTH_M * paper.THICKNESS_M
SOLID = {
    "model": "solid",
    "cells": (1, 2, 40),
    "length_m": LENGTH,
    "until": "impact",
    "its_s": 1e-6,
    "beta_s": 0.0,
    "kn_N_m": KN,
}


def total(form) -> float:
    return COMM.allreduce(fem.assemble_scalar(fem.form(form)))


@pytest.fixture(scope="module")
def upright():
    return bristle.drop(**SOLID)


def test_the_instants_are_those_of_the_march(upright):
    fields = upright.fields
    history = upright.history
    marched = history.t_s[history.t_s >= fields.times_s[0] - 1e-12]
    assert len(fields.displacement) == len(fields.times_s)
    for t in fields.times_s:
        assert np.abs(marched - t).min() < 1e-12
    assert fields.mesh.comm.size == COMM.size
    assert fields.velocity.at(fields.times_s[3] + 1e-9).x.array == pytest.approx(
        fields.velocity[3].x.array
    )
    with pytest.raises(IndexError):
        fields.stress[len(fields.times_s)]


def test_momentum_is_that_of_the_drop(upright):
    """Before the impact all moves at its speed; after it the centre of mass has the drop's speed,
    the last instant lying at most a step of gravity after the release."""
    fields = upright.fields
    before, after = fields.velocity[0], fields.velocity[-1]
    volume = total(1.0 * ufl.dx(domain=fields.mesh))
    assert volume == pytest.approx(LENGTH * AREA)
    mean = [total(v[2] * ufl.dx) / volume for v in (before, after)]
    assert mean[0] == pytest.approx(-upright.impact_speed_m_s, rel=1e-9)
    step = 2.0 * paper.GRAVITY_M_S2 * SOLID["its_s"]
    assert mean[1] == pytest.approx(upright.cm_velocity_after_m_s, abs=step)


def test_contact_presses_as_deep_as_its_force_says(upright):
    """The tip's mean displacement below the plane, times Kn, is the force of that instant."""
    fields, history = upright.fields, upright.history
    tip = ufl.ds(domain=fields.mesh, subdomain_data=fields.facet_tags)(int(Tag.TIP))
    greatest = upright.peak_force_N
    for i in (4, len(fields.times_s) // 3, len(fields.times_s) // 2):
        u = fields.displacement[i]
        depth = -total(u[2] * tip) / AREA
        force = np.interp(fields.times_s[i], history.t_s, history.force_N)
        # the history has the mean over a step, which is half a step older
        assert max(KN * depth, 0.0) == pytest.approx(force, abs=0.05 * greatest)


def test_momentum_balance_of_the_stress(upright):
    """Force through a section is the rate of momentum above it: where the wave has passed once,
    stress is -rho c v in a bar (d'Alembert), taken from the two fields alone."""
    fields = upright.fields
    c = (paper.YOUNGS_PA / paper.DENSITY_KG_M3) ** 0.5
    t = fields.times_s - fields.times_s[0]
    i = int(np.abs(t - 0.6 * LENGTH / c).argmin())
    stress, v = fields.stress[i], fields.velocity[i]
    z = ufl.SpatialCoordinate(fields.mesh)[2]
    behind = ufl.conditional(ufl.lt(z, 0.4 * LENGTH), 1.0, 0.0)
    part = total(behind * ufl.dx)
    axial = total(behind * stress[2, 2] * ufl.dx) / part
    change = total(behind * (v[2] + upright.impact_speed_m_s) * ufl.dx) / part
    assert axial == pytest.approx(-paper.DENSITY_KG_M3 * c * change, rel=0.02)
    assert axial < 0.0


def test_stress_is_that_of_the_displacement(upright):
    """Against UFL's own strain of the displacement, in the mean, where both are smooth."""
    fields = upright.fields
    i = len(fields.times_s) // 2
    u, stress = fields.displacement[i], fields.stress[i]
    strain = ufl.sym(ufl.grad(u))
    mu = paper.YOUNGS_PA / (2.0 * (1.0 + paper.POISSON))
    lame = 2.0 * mu * paper.POISSON / (1.0 - 2.0 * paper.POISSON)
    own = lame * ufl.tr(strain) * ufl.Identity(3) + 2.0 * mu * strain
    difference = stress - own
    error = total(ufl.inner(difference, difference) * ufl.dx)
    assert error < 0.05**2 * total(ufl.inner(own, own) * ufl.dx)
    assert stress.x.array.reshape(-1, 3, 3) == pytest.approx(
        stress.x.array.reshape(-1, 3, 3).transpose(0, 2, 1)
    )


def test_a_leaning_body_stands_where_it_leans():
    """Displacement carries the upright mesh to the lean: its axis has that angle, its length that
    of the bristle but for the elastic change, and the lowest point touches z = 0."""
    found = bristle.drop(**{**SOLID, "tilt_deg": 5.0, "friction": 0.0, "beta_s": 1e-8})
    fields = found.fields
    u = fields.displacement[0]
    top, tip = (
        ufl.ds(domain=fields.mesh, subdomain_data=fields.facet_tags)(int(tag))
        for tag in (Tag.TOP, Tag.TIP)
    )
    ends = [
        np.array([total((ufl.SpatialCoordinate(fields.mesh)[i] + u[i]) * face) for i in range(3)])
        / AREA
        for face in (tip, top)
    ]
    axis = ends[1] - ends[0]
    assert np.linalg.norm(axis) == pytest.approx(LENGTH, rel=1e-9)
    assert np.degrees(np.arccos(axis[2] / LENGTH)) == pytest.approx(5.0, abs=1e-6)
    space = u.function_space
    n = space.dofmap.index_map.size_local
    z = space.tabulate_dof_coordinates()[:n, 2] + u.x.array.reshape(-1, 3)[:n, 2]
    assert COMM.allreduce(z.min(initial=1.0), MPI.MIN) == pytest.approx(0.0, abs=1e-9)
    assert fields.velocity[0].x.array.reshape(-1, 3)[:, 2] == pytest.approx(
        -found.impact_speed_m_s, rel=1e-9
    )


def test_more_instants_than_are_kept_are_thinned_evenly():
    with bristle.Session(COMM) as session:
        few = session.drop(**SOLID, write_every=7).fields.times_s
    steps = np.diff(few) / SOLID["its_s"]
    assert steps == pytest.approx(7.0)


@pytest.mark.parametrize(("count", "most"), [(9, 8), (40, 8), (8, 8)])
def test_a_long_march_keeps_at_most_so_many(upright, count, most):
    class Solid:
        contact = None

    class Marcher:
        class ground:  # noqa: N801
            pose = None

            @staticmethod
            def nearest(contact):
                return np.zeros(3), np.zeros(3)

    class State:
        u = v = np.zeros(3)

        def __init__(self, t_s):
            self.t_s = t_s

    recorder = FieldRecorder(Solid(), Marcher(), most=most)
    for k in range(count):
        recorder(State(float(k)), np.zeros((1, 3)))
    times = [each.t_s for each in recorder._kept]
    assert times[0] == 0.0
    assert len(times) <= most
    assert len(set(np.diff(times))) <= 1
    assert times[-1] > count - 1 - 2 * np.diff(times)[0]


def test_only_the_solid_has_fields():
    assert bristle.drop(model="beam", until="impact").fields is None
