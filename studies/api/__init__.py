"""The Python interface, `import bristle`: every study as a function, with a typed result.

Keyword arguments are the inputs of result.json by name (SI units, angles in degrees), checked as
the command line's are. Under mpirun every rank makes the same call and gets the same answer.
Nothing is printed. Warnings are Python warnings of the category `BristleWarning`, at the line of
the call; they and progress also go to the logger ``bristle``.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import json
import logging
import math
import re
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pydantic
from pydantic import BaseModel

from ...meshes.collective import run_on_one_rank, with_mpi
from ...solver.contact_phase import HISTORY_COLUMNS
from ...solver.effects.base import Effect as Effect
from ...solver.errors import BristleError, InputError
from ..brush.inputs import BrushInputs
from ..drop import run_drop, simulate_drop
from ..inputs.brush_fields import BRUSH_FLAGS
from ..inputs.config import DropInputs, MeshInputs
from ..inputs.fields import DROP_FLAGS, MESH_FLAGS, STUDY_FLAGS, SWEEP_FLAGS
from ..inputs.kinds import forgotten_afterwards
from ..inputs.sources import checked
from ..inputs.study_fields import (
    CALIBRATE_FLAGS,
    LOOP_FLAGS,
    SCATTER_FLAGS,
    SYNTH_FLAGS,
    TRACK_FLAGS,
    CalibrateInputs,
    LoopInputs,
    Recipe,
    TrackInputs,
)
from ..its import ERRORS_FILE, NEEDS_FILE, ItsInputs, run_its
from ..running.cases import CaseSession
from ..running.results import HISTORY_FILE
from ..running.study import TABLE_FILE, Study, rows_of
from ..scatter.inputs import ScatterInputs
from ..sweep import LISTED, SweepInputs, run_sweep
from .records import Brush, Calibration, Dataset, Drop, Mesh, Scatter, TimeSteps, Tracks, Verdict
from .records import Energy as Energy
from .records import Record as Record
from .signatures import Signature, in_python, signed

if TYPE_CHECKING:
    from mpi4py import MPI

    from ...solver.bodies.solid import SolidBody
    from ...solver.contact_phase import Observer
    from ...solver.solid_fields import FieldRecorder
    from ...solver.time.march import ContactMarch

LOG = logging.getLogger("bristle")
Folder = str | Path
# VTK's numbers of a hexahedron with 8, 20 and 27 nodes, and of Lagrange's.
HEXAHEDRA = (12, 25, 29, 72)
SIGNATURES = {
    "drop": Signature(DropInputs, DROP_FLAGS),
    "sweep": Signature(SweepInputs, SWEEP_FLAGS, tuple(LISTED)),
    "its": Signature(ItsInputs, STUDY_FLAGS),
    "scatter": Signature(ScatterInputs, SCATTER_FLAGS),
    "brush": Signature(BrushInputs, BRUSH_FLAGS),
    "calibrate": Signature(CalibrateInputs, CALIBRATE_FLAGS),
    "close_loop": Signature(LoopInputs, LOOP_FLAGS),
    "synth": Signature(Recipe, SYNTH_FLAGS),
    "track": Signature(TrackInputs, TRACK_FLAGS),
    "mesh": Signature(MeshInputs, MESH_FLAGS),
}


class BristleWarning(UserWarning):
    """A doubt about a result, or about the inputs that lead to it."""


class _AsWarnings(logging.Handler):
    """Makes Python warnings of what is logged as warnings, at the caller's line; ``names`` are
    those of `in_python`."""

    def __init__(self, names: Mapping[str, str]) -> None:
        super().__init__()
        self._names = names

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.WARNING:
            message = in_python(record.getMessage(), self._names)
            warnings.warn(message, BristleWarning, skip_file_prefixes=_passed_through())


@functools.cache
def _passed_through() -> tuple[str, ...]:
    """Where frames between the caller and a warning lie, as beginnings of their files' names."""
    package = Path(__file__).parents[2]
    rooms = [str((package / room).resolve()) for room in ("meshes", "solver", "studies")]
    libraries = (str(each.__file__) for each in (contextlib, functools, logging, pydantic))
    return (str(package), *rooms, *(re.sub(r"(__init__)?\.py$", "", each) for each in libraries))


@contextmanager
def _call(names: Mapping[str, str] = {}) -> Iterator[None]:
    """One call: it raises warnings, and forgets the effects and kinds of its plugins. What it warns
    of, and its errors, have the names of inputs in place of those of options."""
    handler = _AsWarnings(names)
    LOG.addHandler(handler)
    try:
        with forgotten_afterwards():
            yield
    except BristleError as error:
        about = f" ({', '.join(error.inputs)})" if error.inputs else ""
        error.args = (f"{in_python(str(error), names)}{about}",)
        raise
    finally:
        LOG.removeHandler(handler)


def _study[R](**words: str) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """A method of `Session`, with the inputs that are declared, and the ``words`` of `signed`."""

    def of(method: Callable[..., R]) -> Callable[..., R]:
        signature = SIGNATURES[method.__name__]
        return _call(signature.names())(signed(signature, **words)(method))

    return of


class Session(CaseSession):
    """Studies that share what is costly to build.

        with bristle.Session() as s:
            for kn in (1e5, 1e6, 1e7):
                s.drop(model="solid", kn_N_m=kn)

    Meshes, matrices, factors, reduced bases and steppers are kept from one call to the next. A drop
    with another stiffness, height, friction or lean then costs its impact alone. The last three or
    four solids are kept; the one that was used longest ago is dropped first. Solids that a sweep
    computes on groups of ranks are dropped when it ends.

    ``comm`` is the communicator whose ranks compute. All of them make the same calls. `close`, or
    the end of the block, frees everything, after an error too.

    Each method is also a function of the package, with a session of its own. Raises InputError if
    ``comm`` is no communicator.
    """

    def __init__(self, comm: MPI.Intracomm | None = None) -> None:
        if comm is not None and not hasattr(comm, "allgather"):
            raise InputError(f"comm: must be a communicator of mpi4py, not {comm!r}")
        super().__init__(comm)

    @_study(
        returns="What result.json holds, the history and the fields.",
        fails="The impact could not be computed.",
        out="A folder for the command's files, fields for ParaView among them.",
    )
    def drop(self, *, out: Folder | None = None, **inputs: Any) -> Drop:
        """One drop, as `bristle drop`: ``bristle.drop(model="solid", tilt_deg=2, friction=0)``.

        The full-order solid keeps its fields at the time steps of the contact. With
        ``write_every=10`` it keeps every tenth.
        """
        asked = self._checked("drop", inputs)
        recorders: list[FieldRecorder] = []

        def observe(solid: SolidBody, marcher: ContactMarch) -> Observer:
            from ...solver.solid_fields import FieldRecorder

            recorders.append(FieldRecorder(solid, marcher, asked.write_every or 1))
            return recorders[-1]

        folder = _folder(out)
        if folder is not None:
            document = run_drop(asked, folder, session=self, observe=observe)
            history = pd.read_csv(folder / HISTORY_FILE)
        else:
            document, result = simulate_drop(asked, self, observe)
            history = pd.DataFrame(result.history.array(), columns=list(HISTORY_COLUMNS))
        return Drop(document, history, recorders[0].fields() if recorders else None)

    @_study(
        returns="A row for each case, with table.csv's columns and one for each further input that "
        'has several values. Its ``attrs["warnings"]`` counts the cases of each warning.',
        fails="A case could not be computed.",
    )
    def sweep(self, *, out: Folder | None = None, **inputs: Any) -> pd.DataFrame:
        """Every combination of several stiffnesses, heights, models and any other numbers or
        choices, as `bristle sweep`: ``bristle.sweep(kn_N_m=[1e5, 2e6], tilt_deg=[0, 2])``."""
        asked = self._checked("sweep", inputs)
        folder = _folder(out)
        if folder is not None:
            run_sweep(asked, folder, session=self)
            return pd.read_csv(folder / TABLE_FILE)
        study = Study("sweep", varied=asked.varied)
        rows = rows_of(study, asked.cases(), self)
        columns = list(study.columns)
        seen = [
            {name: math.nan if row[name] is None else row[name] for name in columns} for row in rows
        ]
        table = pd.DataFrame(seen, columns=columns)
        table.attrs["warnings"] = dict(Counter(each for row in rows for each in row["warnings"]))
        for message, count in table.attrs["warnings"].items():
            LOG.warning("%s (%d of %d cases)", message, count, len(rows))
        return table

    @_study(
        returns="What its.json holds, and the tables of needs, errors and cases.",
        fails="No case could be computed.",
    )
    def its(self, *, out: Folder | None = None, **inputs: Any) -> TimeSteps:
        """The longest integration time step that each quantity allows, as `bristle its`."""
        asked = self._checked("its", inputs)
        with self._into(out) as folder:
            run_its(asked, folder, session=self)
            names = NEEDS_FILE, ERRORS_FILE, TABLE_FILE
            return TimeSteps(self._document(folder / "its.json"), *self._tables(folder, *names))

    @_study(
        returns="What scatter.json holds, and a table with a row for each drop.",
        fails="Too many drops failed.",
    )
    def scatter(self, *, out: Folder | None = None, **inputs: Any) -> Scatter:
        """Many drops that lean by chance onto a rough, composite surface, as `bristle scatter`."""
        from ..scatter.run import DOCUMENT, TABLE, run_scatter

        asked = self._checked("scatter", inputs)
        with self._into(out) as folder:
            run_scatter(asked, folder, with_mpi(self.comm))
            return Scatter(self._document(folder / DOCUMENT), *self._tables(folder, TABLE))

    @_study(
        returns="What result.json holds, and the tables of the hub, of means, and of the tips.",
        fails="The bristles' motion could not be computed.",
    )
    def brush(self, *, out: Folder | None = None, **inputs: Any) -> Brush:
        """Bristles clamped in a hub that is pressed on a surface and moved, as `bristle brush`:
        ``bristle.brush(motion="slide:speed=0.5", mount_angle_deg=30)``."""
        from ..brush.run import HUB_FILE, MEANS_FILE, TIPS_FILE, run_brush

        asked = self._checked("brush", inputs)
        with self._into(out) as folder:
            found = run_brush(asked, folder, self.comm)
            return Brush(found, *self._tables(folder, HUB_FILE, MEANS_FILE, TIPS_FILE))

    @_study(
        returns="What calibrate.json holds.",
        fails="The model's y1/y0 does not fall with Kn.",
        wrong="The dataset or an input is wrong.",
        dataset='Folder of a dataset, or "paper" for what the paper published.',
    )
    def calibrate(
        self, dataset: Folder, *, out: Folder | None = None, **inputs: Any
    ) -> Calibration:
        """Normal contact stiffness with its interval from measured drops, as
        `bristle calibrate`."""
        from ..calibrate.run import run_calibrate

        asked = self._checked("calibrate", inputs)
        where = _dataset(dataset)
        return Calibration(run_calibrate(where, _folder(out), asked, comm=with_mpi(self.comm)))

    @_study(
        returns="What verdict.json holds.",
        fails="A simulation failed.",
        wrong="The dataset or an input is wrong.",
        out="A folder for verdict.json and the page with its figures.",
        dataset="Folder of a dataset.",
    )
    def close_loop(self, dataset: Folder, *, out: Folder | None = None, **inputs: Any) -> Verdict:
        """What the model lacks to explain the measurements in a folder, as `bristle close-loop`."""
        from ..close_loop.run import run_close_loop

        asked = self._checked("close_loop", inputs)
        where = Path(_dataset(dataset))
        return Verdict(run_close_loop(where, _folder(out), asked, comm=with_mpi(self.comm)))

    @_study(
        returns="The truth, and the table of what was measured; of films, of what is in them.",
        fails="A drop could not be computed.",
        out="A folder for the dataset.",
        truth="A file for the truth, outside that folder. Default: beside it.",
    )
    def synth(
        self, *, out: Folder | None = None, truth: Folder | None = None, **inputs: Any
    ) -> Dataset:
        """Measurements with an effect that their dataset does not declare, as `bristle synth`."""
        from ..synth import TABLE_FILE as MEASURED
        from ..synth import frame_of, run_synth

        asked = self._checked("synth", inputs)
        with self._into(out, "dataset") as folder:
            file = _folder(truth, "truth", "a file") or Path(f"{folder}-truth.json")
            found = run_synth(asked, folder, file, self.comm)
            if asked.film:
                table = frame_of(np.array(found["without_noise"]))
            else:
                (table,) = self._tables(folder, MEASURED)
            return Dataset(found, table, None if out is None else folder)

    @_study(
        returns="What track.json holds, and the table of the tracks.",
        fails="An overlay film cannot be written.",
        wrong="A film cannot be read or shows no body that falls, or an input is wrong.",
        out="A folder for the dataset, its page and the overlay films.",
        films="Films, or folders of pictures.",
    )
    def track(
        self, films: Folder | Iterable[Folder], *, out: Folder | None = None, **inputs: Any
    ) -> Tracks:
        """Films of drops as tracks of the lower end, as `bristle track`."""
        from ..track.run import run_track

        asked = self._checked("track", inputs)
        several = [films] if isinstance(films, (str, Path)) else list(films)
        paths = [Path(_dataset(each)) for each in several]
        found, table = run_track(paths, _folder(out), asked, with_mpi(self.comm))
        return Tracks(found, table, None if out is None else Path(out))

    @_study(
        returns="Measures, quality, and the cells as a grid of PyVista.",
        fails="The mesh could not be made.",
    )
    def mesh(self, *, out: Folder | None = None, **inputs: Any) -> Mesh:
        """The hexahedral bristle, as `bristle mesh`."""
        import pyvista

        from ..mesh.run import run_mesh

        spec = self._checked("mesh", inputs).mesh_spec()
        with self._into(out) as folder:
            found = run_mesh(spec, folder, with_mpi(self.comm))
            grid = run_on_one_rank(self.comm, lambda: pyvista.read(folder / "bristle.vtu"))
            return Mesh(found, grid.extract_cells(np.isin(grid.celltypes, HEXAHEDRA)))

    def _checked(self, name: str, values: Mapping[str, Any]) -> Any:
        """The inputs of the method of this name, of keywords; paths, effects and numpy's numbers
        among them. Raises InputError."""
        asked = SIGNATURES[name]
        renamed = asked.aliases()
        for one, other in renamed.items():
            if values.get(one) is not None and values.get(other) is not None:
                raise InputError(f"{one}: given twice, also as {other}")
        known = {*(flag.field for flag in asked.flags), *renamed}
        for each in values:
            if each not in known and each in asked.model.model_fields:
                raise InputError(f"{each}: is no input of {name}")
        plain = {
            renamed.get(each, each): _plain(value)
            for each, value in values.items()
            if not (each in renamed and value is None)
        }
        given = {renamed.get(each, each): each for each in values}
        return checked(
            asked.model, plain, {**{each: each for each in asked.model.model_fields}, **given}
        )

    @contextmanager
    def _into(self, out: Folder | None, name: str = "") -> Iterator[Path]:
        """The folder ``out`` or, for the time of the block, one of all ranks."""
        folder = _folder(out)
        if folder is not None:
            yield folder
            return
        with contextlib.ExitStack() as stack:

            def made() -> Path:
                return Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bristle-")))

            yield run_on_one_rank(self.comm, made) / name

    def _document(self, path: Path) -> dict[str, Any]:
        """A JSON that a study wrote."""
        return run_on_one_rank(self.comm, lambda: json.loads(path.read_text(encoding="utf-8")))

    def _tables(self, folder: Path, *names: str) -> list[pd.DataFrame]:
        """Tables that a study wrote."""
        return run_on_one_rank(self.comm, lambda: [pd.read_csv(folder / name) for name in names])


def _function(name: str) -> Callable[..., Any]:
    """The method of `Session` of this name as a function with a session of its own, on the
    communicator ``comm``."""
    method = getattr(Session, name)

    @functools.wraps(method)
    def call(*args: Any, comm: MPI.Intracomm | None = None, **inputs: Any) -> Any:
        with Session(comm) as session:
            return getattr(session, name)(*args, **inputs)

    there = inspect.signature(method)
    own = [each for each in there.parameters.values() if each.name != "self"]
    kind = inspect.Parameter.KEYWORD_ONLY
    own.append(inspect.Parameter("comm", kind, default=None, annotation="MPI.Intracomm | None"))
    call.__signature__ = there.replace(parameters=own)  # type: ignore[attr-defined]
    call.__qualname__ = name
    del call.__wrapped__
    call.__doc__ = str(method.__doc__).replace(
        "\nReturns\n-------",
        "comm : MPI.Intracomm | None\n    The ranks that compute. Default: all of the job.\n\n"
        "Returns\n-------",
        1,
    )
    return call


drop = _function("drop")
sweep = _function("sweep")
its = _function("its")
scatter = _function("scatter")
brush = _function("brush")
calibrate = _function("calibrate")
close_loop = _function("close_loop")
synth = _function("synth")
track = _function("track")
mesh = _function("mesh")


@_call()
def view(
    result: Folder, *, out: Folder | None = None, comm: MPI.Intracomm | None = None
) -> list[Path]:
    """Draw the result of a drop or a brush, as `bristle view`.

    Parameters
    ----------
    result : str | Path
        Folder of a drop's or a brush's result.
    out : str | Path | None
        Folder for the pictures. Default: ``view`` in that folder.
    comm : MPI.Intracomm | None
        The ranks of which the first draws. Default: all of the job.

    Returns
    -------
    list[Path]
        What was written.

    Raises
    ------
    InputError
        The folder holds no result.
    """
    from ..running.parallel import all_ranks
    from ..view.run import run_view

    return run_view(Path(_dataset(result, "result")), _folder(out), comm or all_ranks())


def _dataset(value: Any, name: str = "dataset") -> str:
    """A folder that must be given."""
    if value is None or (isinstance(value, str) and not value):
        raise InputError(f"{name}: must be a folder, not {value!r}")
    return str(_folder(value, name))


def _folder(value: Any, name: str = "out", what: str = "a folder") -> Path | None:
    """A path that may be given."""
    if value is None:
        return None
    if not isinstance(value, str | Path) or not str(value) or "\0" in str(value):
        raise InputError(f"{name}: must be {what}, not {value!r}")
    return Path(value)


def _plain(value: Any) -> Any:
    """A value as the inputs take it: paths as text, arrays and other collections as lists."""
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):  # numbers and arrays of numpy, series of pandas
        return value.tolist()
    if isinstance(value, str | Mapping | BaseModel) or not hasattr(value, "__iter__"):
        return value
    return [_plain(each) for each in value]
