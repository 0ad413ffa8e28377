"""A surface comes back from its file; a broken file says where it is broken."""

import zipfile

import numpy as np
import pytest

from bristle.studies.surface.files import read_map, read_surface
from bristle.studies.surface.phases import Composite

pytestmark = pytest.mark.serial


@pytest.fixture
def heights(rng):
    drawn = rng.normal(size=(6, 5)) * 1e-6
    return drawn - drawn.mean()


def write_points(path, heights, spacing, rng, separator=" ", origin=(3e-3, -1e-3)):
    ny, nx = heights.shape
    j, i = np.divmod(rng.permutation(nx * ny), nx)
    x, y = origin[0] + i * spacing, origin[1] + j * spacing
    lines = [
        separator.join(map(repr, map(float, row))) for row in np.column_stack([x, y, heights[j, i]])
    ]
    path.write_text("\n".join(lines))


# --- measured maps ----------------------------------------------------------------------------


@pytest.mark.parametrize("separator", [" ", "\t", ",", "; "])
@pytest.mark.parametrize("kind", ["matrix", "points"])
def test_text_kinds_give_the_same_surface(heights, kind, separator, rng, tmp_path):
    path = tmp_path / "a.txt"
    if kind == "points":
        write_points(path, heights, 2e-5, rng, separator)
    else:
        rows = [separator.join(map(repr, map(float, row))) for row in heights]
        path.write_text("\n".join(["# measured", "# spacing_m = 2e-5", "", *rows]))
    found, spacing_m = read_map(path)
    assert found == pytest.approx(heights, abs=1e-18)
    assert spacing_m == pytest.approx(2e-5, rel=1e-9)


def test_column_names_are_passed_over_and_an_archive_says_the_same(heights, rng, tmp_path):
    points, arrays = tmp_path / "a.csv", tmp_path / "b.npz"
    write_points(points, heights, 2e-5, rng, ",")
    points.write_text("x,y,z\n" + points.read_text())
    np.savez(arrays, heights_m=heights, spacing_m=2e-5)
    for path in (points, arrays):
        found, spacing_m = read_map(path)
        assert found == pytest.approx(heights, abs=1e-18)
        assert spacing_m == pytest.approx(2e-5)


def test_a_tilted_map_is_levelled_and_goes_on_by_its_mirror_image(rng, tmp_path):
    ny, nx, spacing_m = 12, 9, 50e-6
    x, y = np.arange(nx), np.arange(ny)[:, None]
    tilted = 5.0 + 0.01 * x - 0.02 * y
    np.savez(tmp_path / "a.npz", heights_m=tilted, spacing_m=spacing_m)
    flat = read_surface(tmp_path / "a.npz")
    assert flat.heights_m == pytest.approx(np.zeros((22, 16)), abs=1e-14)
    rough = 1e-7 * rng.normal(size=(ny, nx))
    np.savez(tmp_path / "b.npz", heights_m=tilted + rough, spacing_m=spacing_m)
    made = read_surface(tmp_path / "b.npz")
    terms = np.stack([np.ones((ny, nx)), x + 0 * y, y + 0 * x], axis=-1).reshape(-1, 3)
    plane = terms @ np.linalg.lstsq(terms, rough.ravel())[0]
    assert made.heights_m[:ny, :nx] == pytest.approx(rough - plane.reshape(ny, nx), abs=1e-14)
    # Even about both edges: the first and the last row and column.
    for axis, n in ((0, ny), (1, nx)):
        assert np.array_equal(made.heights_m, np.roll(np.flip(made.heights_m, axis), 1, axis))
        turned = np.roll(np.flip(made.heights_m, axis), 2 * n - 1, axis)
        assert np.array_equal(made.heights_m, turned)


def test_measured_maps_get_phases_of_concrete(tmp_path):
    np.savez(tmp_path / "a.npz", heights_m=np.zeros((201, 201)), spacing_m=200e-6)
    made = read_surface(tmp_path / "a.npz", seed=4)
    assert made.composite == Composite()
    assert made.fractions == pytest.approx([0.30, 0.28, 0.42], abs=0.01)
    again = read_surface(tmp_path / "a.npz", seed=4)
    assert np.array_equal(again.phase, made.phase)
    assert not np.array_equal(read_surface(tmp_path / "a.npz").phase, made.phase)


# --- broken files -----------------------------------------------------------------------------

GRID = "".join(f"{x} {y} 0\n" for x in range(5) for y in range(5))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.txt: there are no numbers in it"),
        ("# nothing\nx y z\n", "there are no numbers in it"),
        ("1 2 3 4\n1 2 3\n", "a.txt:2: 3 numbers where line 1 has 4"),
        ("# h\n\n1 2 3 4\n1 2 x 4\n", "a.txt:4: 'x' is not a number"),
        ("1 2 3 4\na b c d\n", "a.txt:2: 'a' is not a number"),
        ("1;2;3,5;4\n", "a.txt:1: '3,5' is not a number"),
        ("1,2,,4\n", "a.txt:1: '' is not a number"),
        ("1 2 3 4\n1 2 nan 4\n", "a.txt:2: 'nan' is not a height; fill"),
        ("# spacing_m = 0\n1 2 3 4\n", "a.txt:1: spacing_m must be positive"),
        ("# spacing_m = wide\n1 2 3 4\n", "a.txt:1: 'wide' is not a number"),
        ("1 2 3 4\n" * 4, "a matrix of 4 × 4 heights needs a spacing"),
        ("# spacing_m = 1\n" + "1 2 3 4 5\n" * 3, "at least 4 × 4 heights is needed, not 3 × 5"),
        ("# spacing_m = 1\n" + GRID, "has its spacing from its points"),
        (GRID + "2 3 1\n", "a.txt:26: the same point as in line 14"),
        (
            GRID.replace("1 2 0\n", ""),
            "1 points of the 5 × 5 grid are missing, .* x = 1 m, y = 2 m",
        ),
        (GRID.replace("3 3 0\n", "3.2 3 0\n"), "a.txt:19: x = 3.2 m is not on the grid"),
        (GRID.replace(" 4 0\n", " 5 0\n"), "5 points of the 6 × 5 grid are missing"),
        ("".join(f"1 {y} 0\n" for y in range(5)), "all points have the same x"),
        ("".join(f"{2 * x} {y} 0\n" for x in range(5) for y in range(5)), "2 m in x and 1 m in y"),
        (GRID.replace("4 ", "1e5 "), "too scattered"),
    ],
)
def test_broken_text_is_refused_with_its_line(text, message, tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as refused:
        read_surface(path)
    assert str(refused.value).startswith(str(path))


def test_other_broken_files_are_refused(heights, tmp_path):
    path = tmp_path / "a.npz"

    def refuse(message, **arrays):
        if arrays:
            np.savez(path, **arrays)
        with pytest.raises(ValueError, match=message):
            read_surface(path)

    refuse("no array heights_m, only z", z=heights)
    refuse("no array spacing_m", heights_m=heights)
    refuse("spacing_m must be one number, not 2", heights_m=heights, spacing_m=[1.0, 2.0])
    refuse("spacing_m must be positive", heights_m=heights, spacing_m=-1.0)
    refuse("not finite", heights_m=heights * np.nan, spacing_m=1.0)
    refuse("heights_m holds <U1, not numbers", heights_m=np.full((5, 5), "a"), spacing_m=1.0)
    refuse("4 × 4 heights is needed, not 30", heights_m=heights.ravel(), spacing_m=1.0)
    refuse("too coarse for the fine aggregate", heights_m=heights, spacing_m=1.0)
    refuse("Object arrays", heights_m=np.array([{}, 1], dtype=object), spacing_m=1.0)
    np.savez(path, heights_m=heights, spacing_m=1e-4)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refuse("is not a file of plain arrays")
    path.write_bytes(b"")
    refuse("is not a file of plain arrays")
    with path.open("wb") as file:
        np.save(file, heights)
    refuse("is not a file of plain arrays")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("heights_m.txt", "1")
    refuse("no array heights_m")
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="is not a text file"):
        read_surface(tmp_path / "a.csv")
    with pytest.raises(ValueError, match="from .npz, .csv or .txt, not '.stl'"):
        read_surface(tmp_path / "a.stl")
    with pytest.raises(FileNotFoundError):
        read_surface(tmp_path / "none.csv")
