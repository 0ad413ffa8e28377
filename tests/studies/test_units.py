"""A dataset in other units than it says is refused by file and line, before it computes."""

import hostile
import pytest
from hostile import TABLES, drops_table, manifest, write_dataset

from bristle.studies.close_loop import run as loop_study
from bristle.studies.data.datasets import read_drops
from bristle.studies.loop.kinds.forces.record import read_forces

pytestmark = [pytest.mark.serial, pytest.mark.usefixtures("no_pictures")]


@pytest.fixture(autouse=True)
def nothing_is_computed(monkeypatch):
    def computed(*arguments, **options):
        raise AssertionError("it was taken for what it says")

    monkeypatch.setattr(loop_study, "_simulate", computed)


def scaled(text, name, factor, only=None):
    """A table with one column, or one row of it, multiplied."""
    head, *rows = text.splitlines()
    column = head.split(",").index(name)
    for i, row in enumerate(rows):
        if only is None or i == only:
            cells = row.split(",")
            cells[column] = repr(float(cells[column]) * factor)
            rows[i] = ",".join(cells)
    return "\n".join([head, *rows]) + "\n"


def refused(folder, out):
    """The message of a dataset that is refused, of which no result is left."""
    said = hostile.refused("close-loop", folder, "--out", out)
    assert not out.exists()
    return said


@pytest.mark.parametrize("factor", [1e-3, 1e3])
@pytest.mark.parametrize(
    ("kind", "name", "line"),
    [
        ("drops", "y0_mm", 2),
        ("drops", "y1_mm", 2),
        ("drops", "contact_time_ms", 2),
        ("drops", "peak_force_N", 2),
        ("forces", "t_s", 10),  # where the force is greatest
        ("forces", "force_N", 10),
    ],
)
def test_a_column_in_another_unit_is_refused_by_its_line(tmp_path, kind, name, line, factor):
    table = scaled(TABLES[kind][1], name, factor)
    folder = write_dataset(tmp_path / "data", kind, table=table)
    said = refused(folder, tmp_path / "out")
    assert said.startswith(f"{folder / TABLES[kind][0]}:{line}: {name}")


@pytest.mark.parametrize("name", ["y0_mm", "y1_mm", "contact_time_ms", "peak_force_N"])
def test_so_is_one_row(tmp_path, name):
    table = scaled(drops_table(), name, 1e3, only=4)
    folder = write_dataset(tmp_path / "data", "drops", table=table)
    assert refused(folder, tmp_path / "out").startswith(f"{folder / 'drops.csv'}:6: {name}")


@pytest.mark.parametrize("factor", [1e-3, 1e3])
@pytest.mark.parametrize("name", ["y0_mm", "y1_mm"])
def test_so_are_the_heights_beside_forces(tmp_path, name, factor):
    folder = write_dataset(tmp_path / "data", "forces")
    (folder / "drops.csv").write_text(scaled(drops_table(), name, factor))
    assert refused(folder, tmp_path / "out").startswith(f"{folder / 'drops.csv'}:2: {name}")


@pytest.mark.parametrize(
    ("name", "factor", "says"),
    [
        ("y_mm", 1e3, "tracks.csv:2: y_mm of 42000 is beyond 10000; is it in mm?"),
        ("y_mm", 1e-3, "tracks.csv:2: 0 of 8 drops show a fall unmistakably"),
        ("t_s", 1e-3, "Is t_s in s, and y_mm in mm?"),
    ],
)
def test_so_is_a_film(tmp_path, name, factor, says):
    tree = manifest("tracks", measurement={"file": "tracks.csv"})
    table = scaled(TABLES["tracks"][1], name, factor)
    folder = write_dataset(tmp_path / "data", "tracks", tree, table)
    assert says in refused(folder, tmp_path / "out")


def test_so_are_forces_of_the_other_sign(tmp_path):
    table = scaled(TABLES["forces"][1], "force_N", -1.0)
    folder = write_dataset(tmp_path / "data", "forces", table=table)
    said = refused(folder, tmp_path / "out")
    assert said.startswith(f"{folder / TABLES['forces'][0]}:10: drop 1 never presses harder")


@pytest.mark.parametrize("kind", ["drops", "tracks", "forces"])
@pytest.mark.parametrize(
    ("part", "key", "value"),
    [
        ("measurement", "sigma_y_mm", 500.0),
        ("measurement", "gravity_m_s2", 9800.0),
        ("measurement", "gravity_m_s2", 981.0),
        ("measurement", "gravity_m_s2", 9.8e-3),
        ("body", "length_m", 336.5),
        ("body", "length_m", 33.65),
        ("body", "length_m", 0.3365e-3),
        ("body", "thickness_m", 0.5),
        ("body", "density_kg_m3", 7.8),
        ("body", "youngs_modulus_Pa", 207.0),
        ("body", "youngs_modulus_Pa", 207e3),
        ("body", "youngs_modulus_Pa", 207e12),
        ("body", "youngs_modulus_Pa", 10.0e12),
        ("body", "width_m", 0.5),
        ("body", "diameter_m", 0.5),
        ("body", "damping_beta_s", 1.07e-2),
    ],
)
def test_so_is_a_declaration(tmp_path, kind, part, key, value):
    tree = manifest(kind, body={})
    tree[part] = {**tree[part], key: value}
    folder = write_dataset(tmp_path / "data", kind, tree)
    said = refused(folder, tmp_path / "out")
    lines = (folder / "dataset.toml").read_text().splitlines()
    stands = [n for n, text in enumerate(lines, 1) if text.startswith(f'"{key}"')]
    assert said.startswith(f"{folder / 'dataset.toml'}:{stands[0]}: {key}")


@pytest.mark.parametrize("key", ["sigma_t_s", "sigma_force_N"])
def test_so_is_an_uncertainty_of_drops(tmp_path, key):
    tree = manifest("drops")
    tree["measurement"] |= {key: 50.0}
    folder = write_dataset(tmp_path / "data", "drops", tree)
    assert f": {key} of 50 is more than any value measured" in refused(folder, tmp_path / "out")


@pytest.mark.parametrize("kind", ["drops", "forces"])
def test_what_was_not_measured_is_in_no_unit(tmp_path, kind):
    """Empty cells, and a contact of 3 ms as a soft brush has, are taken."""
    folder = write_dataset(tmp_path / "data", kind)
    table = drops_table().replace(",0.16,40\n", ",,\n", 3).replace(",0.16,", ",3,")
    (folder / "drops.csv").write_text(table)
    read = (read_drops if kind == "drops" else read_forces)(folder)
    assert len(read.drop) >= 7
