"""A mesh specification refuses what cannot be meshed, and counts what it asks for."""

import math
import pickle

import numpy as np
import pytest
from scipy import integrate

from bristle.meshes.geometry import MeshSpec, Tag
from bristle.meshes.section import Circle, Rectangle


def test_default_is_the_papers_bristle():
    spec = MeshSpec()
    assert (spec.length_m, spec.section.thickness_m, spec.section.width_m) == (
        0.3365,
        0.0005,
        0.00208,
    )
    assert spec.cells == (1, 4, 337)
    # 2.73 g of steel of 7800 kg/m³, as the paper weighs it.
    assert spec.volume_m3 * 7800 == pytest.approx(2.73e-3, abs=0.005e-3)


@pytest.mark.parametrize("section", [Rectangle(3.0, 2.0), Circle(2.5)])
def test_section_properties_are_the_integrals(section):
    if isinstance(section, Rectangle):
        x_max, half_width = section.thickness_m / 2, lambda x: section.width_m / 2
    else:
        x_max = section.diameter_m / 2
        half_width = lambda x: math.sqrt(max(x_max**2 - x**2, 0.0))  # noqa: E731

    def over_section(f):
        inner = lambda x: integrate.quad(lambda y: f(x, y), 0, half_width(x))[0]  # noqa: E731
        return 4 * integrate.quad(inner, 0, x_max)[0]

    assert section.area_m2 == pytest.approx(over_section(lambda x, y: 1.0), rel=1e-8)
    expected = [over_section(lambda x, y: x * x), over_section(lambda x, y: y * y)]
    found = [section.second_moment_x_m4, section.second_moment_y_m4]
    assert found == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("nz", [1, 2, 7, 400])
@pytest.mark.parametrize("grading", [0.2, 1.0, 1.0 + 1e-13, 5.0])
def test_levels_grow_geometrically(nz, grading):
    levels = MeshSpec(cells=(1, 1, nz), grading=grading).levels_m
    lengths = np.diff(levels)
    assert levels[0] == 0.0
    assert levels[-1] == 0.3365
    assert len(lengths) == nz
    if nz > 1:
        assert lengths[-1] / lengths[0] == pytest.approx(grading, rel=1e-10)
        assert lengths[1:] / lengths[:-1] == pytest.approx(grading ** (1 / (nz - 1)), rel=1e-10)


def test_counts_of_a_block_and_of_an_o_grid():
    block = MeshSpec(cells=(2, 3, 5))
    assert block.n_cells == 30
    assert block.n_facets == {Tag.TIP: 6, Tag.TOP: 6, Tag.SIDE: 50}
    # Core 2 × 2 and four blocks of 2 × 3.
    wire = MeshSpec(section=Circle(1e-3), cells=(2, 3, 5))
    assert wire.n_cells == (4 + 24) * 5
    assert wire.n_facets == {Tag.TIP: 28, Tag.TOP: 28, Tag.SIDE: 40}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Rectangle(thickness_m=0.0), "thickness_m must be positive and finite, not 0.0"),
        (lambda: Rectangle(width_m=-1.0), "width_m must be positive and finite"),
        (lambda: Rectangle(width_m="2"), "width_m must be a number, not '2'"),
        (lambda: Circle(math.nan), "diameter_m must be positive and finite, not nan"),
        (lambda: Circle(True), "diameter_m must be a number"),
        (lambda: MeshSpec(length_m=math.inf), "length_m must be positive and finite"),
        (lambda: MeshSpec(grading=0), "grading must be positive"),
        (lambda: MeshSpec(section=(1, 2)), "section must be a Rectangle or a Circle"),
        (lambda: MeshSpec(cells=(1, 4)), "cells must be three numbers NX, NY, NZ"),
        (lambda: MeshSpec(cells=5), "cells must be three numbers NX, NY, NZ, not 5"),
        (lambda: MeshSpec(cells=(1, 0, 3)), "NY must be a whole number from 1, not 0"),
        (lambda: MeshSpec(cells=(1, 1, 3.0)), "NZ must be a whole number from 1, not 3.0"),
        (lambda: MeshSpec(cells=(True, 1, 3)), "NX must be a whole number from 1, not True"),
        (lambda: MeshSpec(geometry_order=3), "geometry_order must be 1 or 2, not 3"),
        (lambda: MeshSpec(geometry_order=1.0), "geometry_order must be 1 or 2, not 1.0"),
        (lambda: MeshSpec(grading=1e9), "too short to mesh"),
        (lambda: MeshSpec(section=Circle(1e-7)), "too short to mesh"),
        (lambda: MeshSpec(cells=(10000, 1, 1)), "too short to mesh"),
    ],
)
def test_wrong_input_is_refused_in_words(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("section", "cells"),
    [
        (Rectangle(3e-3, 1e-3), (2500, 1, 1)),  # thickness over NX
        (Rectangle(1e-3, 3e-3), (1, 2500, 1)),  # width over NY
        (Circle(6e-3), (2500, 1, 1)),  # the core is half as wide as the section
        (Circle(6e-3), (1, 1250, 1)),  # and the ring a quarter
        (Rectangle(1e-3, 1e-3), (1, 1, 833333)),  # length over NZ
    ],
)
def test_the_shortest_edge_is_a_millionth_of_the_largest_measure(section, cells):
    """Each of these makes edges of 1.2 µm."""
    assert MeshSpec(1.0, section, cells).cells == cells
    with pytest.raises(ValueError, match="make an edge of 1.2e-06 m on a body of 1.21 m"):
        MeshSpec(1.21, section, (cells[0], cells[1], round(1.21 * cells[2])))


def test_a_section_may_be_the_largest_measure():
    with pytest.raises(ValueError, match="1.2e-06 m on a body of"):
        MeshSpec(1.2e-6, Rectangle(1.0, 1.21 * 1.2), (1, 1, 1))


def test_spec_is_a_value():
    spec = MeshSpec(cells=[np.int64(1), 2, 3], geometry_order=np.int32(2))
    assert spec == MeshSpec(cells=(1, 2, 3), geometry_order=2)
    assert hash(spec) == hash(MeshSpec(cells=(1, 2, 3), geometry_order=2))
    assert type(spec.cells[0]) is int
    assert pickle.loads(pickle.dumps(spec)) == spec
