"""What several test modules share: the paper's bristle, and small solids made once."""

from __future__ import annotations

import locale
import os
import signal

import numpy as np
import pytest
from drawing import draw_nothing
from mpi4py import MPI
from turns import take_turns

if "PYTEST_XDIST_WORKER" in os.environ:
    take_turns()

from bristle.meshes.section import Rectangle
from bristle.solver.bristle import CONTACT_POINTS, Bristle, Material

# A script's job in the background has Ctrl-C ignored, and what tests start would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _same_locale():
    """VTK's reader of legacy files sets the locale "C" until it is collected."""
    before = locale.setlocale(locale.LC_ALL)
    yield
    locale.setlocale(locale.LC_ALL, before)


@pytest.fixture(scope="session")
def bristle() -> Bristle:
    return Bristle()


@pytest.fixture(scope="session")
def make_solid():
    """A function that builds (and remembers) a solid: cells, length, order, material, section."""
    from bristle.meshes import geometry
    from bristle.meshes.distribute import to_dolfinx
    from bristle.solver.bodies.solid import SolidBody

    made: dict = {}

    def build(
        cells=(1, 2, 24),
        length_m=0.02,
        order=2,
        material=None,
        section=None,
        comm=MPI.COMM_WORLD,
        geometry_order=1,
        points=CONTACT_POINTS,
    ) -> SolidBody:
        material = material or Material()
        section = section or Rectangle()
        key = (cells, length_m, order, material, section, comm.size, geometry_order, points)
        if key not in made:
            spec = geometry.MeshSpec(length_m, section, cells, geometry_order)
            domain, _, facets = to_dolfinx(spec, comm)
            made[key] = SolidBody(domain, facets, int(geometry.Tag.TIP), material, order, points)
        return made[key]

    yield build
    for solid in made.values():
        solid.close()


@pytest.fixture(scope="module")
def no_pictures():
    with pytest.MonkeyPatch.context() as patch:
        draw_nothing(patch)
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)
