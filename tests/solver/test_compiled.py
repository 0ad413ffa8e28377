"""Compiling ends well when others compile the same, are killed, or nothing can be written."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import numpy as np
import pytest
import readme
from commands import environment, mpirun, python
from mpi4py import MPI

from bristle.solver.bristle import Material
from bristle.solver.compiled import nth, unowned, write
from bristle.solver.rods.chain import Chain
from bristle.solver.rods.motion import ClampedRod, motion_of

pytestmark = pytest.mark.serial

# a form of one cell: the volume of a block, 2 m high
FORM = """
import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI
from bristle.solver.form_cache import form
import ufl
comm = MPI.COMM_WORLD
corners = [np.zeros(3), np.array([1.0, 1.0, 2.0])]
block = mesh.create_box(comm, corners, [1, 1, 2], mesh.CellType.hexahedron)
volume = fem.assemble_scalar(form(fem.Constant(block, 1.0) * ufl.dx(block)))
total = comm.allreduce(volume)
if comm.rank == 0:
    print(round(total, 9))
"""
# a function of the package, and whether its machine code was read from the cache
ROTATION = """
import numpy as np
from bristle.solver.rigid import matrix_of
assert (matrix_of(np.array([1.0, 0.0, 0.0, 0.0])) == np.eye(3)).all()
print(sum(matrix_of.stats.cache_hits.values()), matrix_of.stats.cache_path)
"""
# many further types of one function, as numba keeps them
INDEX = """
import sys
from pathlib import Path
from bristle.solver.compiled import numba
from numba.core import caching
folder, name, other = sys.argv[1:]
index = caching.IndexDataCacheFile(folder, "function", "stamp")
Path(folder, name).touch()
while not Path(folder, other).exists():
    pass  # both begin together
for i in range(60):
    index.save((name, i), [name, i])
"""
# two threads that each time meet a type for the first time, at once
TYPES = """
import threading
import numpy as np
from bristle.solver.compiled import in_turn, meanwhile, numba

@numba.njit(nogil=True)
def count(arrays, waits):
    for i in range(waits):
        if arrays[0][0] > 1.0:
            return 0
    return len(arrays)

def both(arrays):
    barrier = threading.Barrier(2)
    found = []

    def one():
        barrier.wait()
        with in_turn():
            found.append((meanwhile(count, arrays, 10_000), count(arrays, 1)))

    threads = [threading.Thread(target=one) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found

print(all(both((np.zeros(2),) * size) == [(size, size)] * 2 for size in range(1, 31)))
"""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder for the processes that a test starts."""
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    return folder


def at_once(*starts: Callable[[], subprocess.CompletedProcess[str]]) -> list[str]:
    """What processes print that are started together, all of which must end well."""
    with ThreadPoolExecutor(len(starts)) as pool:
        done = [each.result() for each in [pool.submit(start) for start in starts]]
    assert [each.returncode for each in done] == [0] * len(done), [each.stderr for each in done]
    return [each.stdout.strip() for each in done]


def compiled(cache: Path) -> list[str]:
    return sorted(path.suffix for path in cache.rglob("libffcx*") if path.is_file())


def test_cold_processes_compile_once_between_them(cache):
    """And one that comes later compiles nothing again."""
    assert at_once(*[lambda: python("-c", FORM)] * 3) == ["2.0"] * 3
    assert compiled(cache) == [".c", ".cached", ".o", ".so"]
    (library,) = cache.rglob("libffcx*.so")
    before = library.stat().st_mtime_ns
    at_once(lambda: python("-c", FORM))
    assert library.stat().st_mtime_ns == before


def test_cold_ranks_of_two_jobs_compile_once_between_them(cache):
    assert at_once(*[lambda: mpirun(2, "-c", FORM)] * 2) == ["2.0"] * 2
    assert compiled(cache) == [".c", ".cached", ".o", ".so"]


def test_a_copy_of_the_package_compiles_nothing_again(cache, tmp_path):
    """An installation, a clone: other folders and other dates of the same sources."""
    first, folder = at_once(lambda: python("-c", ROTATION))[0].split()
    copy = tmp_path / "copy" / "bristle"
    shutil.copytree(readme.REPOSITORY / "solver", copy / "solver")
    for path in (copy / "__init__.py", *copy.rglob("*.py")):
        path.touch()
    read = f"import sys; sys.path.insert(0, {str(copy.parent)!r})"
    assert (first, at_once(lambda: python("-c", read + ROTATION))) == ("0", [f"1 {folder}"])
    changed = copy / "solver" / "materials.py"
    changed.write_text(changed.read_text() + "# changed\n")
    hits, other = at_once(lambda: python("-c", read + ROTATION))[0].split()
    assert (hits, other == folder) == ("0", False)


def test_a_killed_compile_is_made_anew(cache):
    process = subprocess.Popen([sys.executable, "-c", FORM], env=environment(), text=True)
    until = time.monotonic() + 60.0
    while ".c" not in compiled(cache) and time.monotonic() < until:
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert ".cached" not in compiled(cache)
    assert ".c" in compiled(cache)
    assert at_once(lambda: python("-c", FORM)) == ["2.0"]
    assert ".cached" in compiled(cache)


@pytest.mark.parametrize("where", ["a file", "/proc/nowhere"])
def test_a_cache_that_cannot_be_written_is_done_without(where, tmp_path, monkeypatch):
    (tmp_path / "a file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / where))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    assert at_once(lambda: python("-c", FORM)) == ["2.0"]
    assert compiled(tmp_path) == [".c", ".cached", ".o", ".so"]


# where code is kept, and what was said of it
WHERE = """
import logging, sys
logging.basicConfig(format="%(message)s", stream=sys.stdout)
from bristle.solver.compiled import cache_folder
print(cache_folder())
"""


def open_to_the_group(folder: Path) -> None:
    folder.mkdir(parents=True)
    folder.chmod(0o775)


def open_to_all(folder: Path) -> None:
    folder.mkdir(parents=True)
    folder.chmod(0o757)


def someone_elses(folder: Path) -> None:
    folder.mkdir(parents=True)
    try:
        os.chown(folder, 1234, -1)
    except PermissionError:
        pytest.skip("only root gives folders away")


def a_link(folder: Path) -> None:
    elsewhere = folder.with_name("elsewhere")
    elsewhere.mkdir(parents=True)
    folder.symlink_to(elsewhere)


@pytest.mark.parametrize(
    ("plant", "level"),
    [
        (open_to_the_group, 0),
        (open_to_the_group, 1),
        (open_to_all, 2),
        (someone_elses, 0),
        (someone_elses, 2),
        (a_link, 1),
        (a_link, 2),
    ],
)
def test_a_cache_that_others_could_write_is_not_read(cache, tmp_path, monkeypatch, plant, level):
    """Numba unpickles what lies in it, and what FFCx compiled is loaded: both run it."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    (own,) = at_once(lambda: python("-c", WHERE))
    names = Path(own).relative_to(cache).parts
    assert len(names) == 3
    shutil.rmtree(cache / "bristle")
    planted = cache.joinpath(*names[: level + 1])
    plant(planted)
    second = tmp_path / f"bristle-{os.getuid()}"
    said, found = at_once(lambda: python("-c", WHERE))[0].splitlines()
    assert said.startswith(f"{planted} is no cache that is safe to use")
    assert found == str(second / "compiled" / names[-1])
    assert list(planted.iterdir()) == []
    # that one has a name that others can guess, and where it is theirs it is not read either
    shutil.rmtree(second)
    plant(second)
    *_, found = at_once(lambda: python("-c", WHERE))[0].splitlines()
    assert Path(found).parents[2] == tmp_path
    assert Path(found).parents[1] != second
    assert not Path(found).parents[1].exists()  # it went with its process


def test_the_folders_of_a_cache_are_for_their_user_alone(cache):
    (found,) = at_once(lambda: python("-c", WHERE))
    for folder in (Path(found), *Path(found).parents[:2]):
        assert folder.stat().st_mode & 0o777 == 0o700
        assert folder.stat().st_uid == os.getuid()


def test_where_no_cache_can_be_made_what_is_old_beside_it_stays(tmp_path, monkeypatch):
    """Old versions of compiled code are removed; a folder of the process alone lies among those of
    other programs."""
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    (tmp_path / f"bristle-{os.getuid()}").touch()
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "file").write_text("the user's")
    os.utime(tmp_path / "old", (0.0, 0.0))
    at_once(lambda: python("-c", WHERE))
    assert (tmp_path / "old" / "file").read_text() == "the user's"


def test_no_type_of_a_function_is_lost_where_two_compile_it_at_once(cache, tmp_path):
    folder = tmp_path / "index"
    folder.mkdir()
    at_once(
        lambda: python("-c", INDEX, folder, "one", "other"),
        lambda: python("-c", INDEX, folder, "other", "one"),
    )
    check = """
import sys
from bristle.solver.compiled import numba
from numba.core import caching
index = caching.IndexDataCacheFile(sys.argv[1], "function", "stamp")
keys = [(name, i) for name in ("one", "other") for i in range(60)]
print(sum(index.load(key) == list(key) for key in keys))
"""
    assert at_once(lambda: python("-c", check, folder)) == ["120"]


def test_threads_may_meet_a_type_for_the_first_time_at_once(cache):
    assert at_once(lambda: python("-c", TYPES)) == ["True"]


def test_unowned_arrays_are_the_same_memory():
    @numba.njit
    def doubled(record):
        arrays, factor = unowned(record)
        arrays[0][1] *= factor
        return arrays[0][1] + arrays[1].sum()

    one, two = np.array([1.0, 2.0]), np.ones((2, 3))
    assert doubled(((one, two), 2.0)) == 10.0
    assert one[1] == 4.0


def test_the_nth_of_a_stack_is_a_record_of_views():
    """The records are the solver's: what is compiled for other classes stays in the cache."""
    lengths, nodes = np.ones((3, 2)), np.ones((3, 3))
    chain = Chain(lengths, lengths, lengths, nodes, nodes, np.arange(3.0), 0.5)
    stack = ClampedRod(chain, np.zeros((3, 3, 6)), np.zeros((3, 3), order="F"), np.zeros((3, 4)))
    one = nth(stack, 1)
    assert isinstance(one, ClampedRod)
    assert isinstance(one.chain, Chain)
    assert (one.chain.beta, one.chain.alpha) == (1.0, 0.5)
    one.place[:] = 5.0
    assert stack.place.tolist() == [[0.0] * 3, [5.0] * 3, [0.0] * 3]


def test_a_record_is_written_over_another_array_by_array():
    """And as much of a longer one as there is room for."""
    from_there, into = (motion_of(rods, 3, 2) for rods in (3, 2))
    for k, each in enumerate([*from_there[:-1], *from_there.touch]):
        each.ravel()[:] = np.arange(each.size) + k
    write(from_there, into)
    for source, found in zip(
        [*from_there[:-1], *from_there.touch], [*into[:-1], *into.touch], strict=True
    ):
        assert np.array_equal(found, source[:2])
        assert found.any()


def test_one_compiled_form_serves_all_materials(make_solid, tmp_path, monkeypatch):
    monkeypatch.setattr("bristle.solver.form_cache._folder", lambda: tmp_path)
    other = Material(youngs_Pa=1.5e9, poisson=0.42, density_kg_m3=910.0, beta_s=1e-4)
    counts = []
    for material in (Material(beta_s=3e-6), other):
        make_solid((1, 1, 3), order=1, material=material, comm=MPI.COMM_SELF)
        counts.append(len(list(tmp_path.glob("*.c"))))
    assert counts[0] > 0
    assert counts[1] == counts[0]
