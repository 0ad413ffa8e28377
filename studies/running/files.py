"""Files and folders written whole and together, or not at all."""

from __future__ import annotations

import csv
import errno
import io
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...solver.errors import ComputationError, InputError
from .interrupts import uninterrupted
from .lock import lock_folder

# How the names of things begin until they are whole.
UNFINISHED = ".bristle-unfinished-"


def prepare_folder(out: Path) -> None:
    """Make ``out`` where it is missing; InputError where it is a file or cannot be written.

    What a run that was killed left there unfinished is removed; one that still writes there is
    waited for (`lock_folder`).
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock_folder(out)
        for path in out.iterdir():
            if path.name.startswith(UNFINISHED):
                remove(path)
        with tempfile.TemporaryFile(dir=out):
            pass
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"--out {out}: there is a file of that name, not a folder") from None
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror}") from error


@contextmanager
def new_folders(out: Path) -> Iterator[None]:
    """Where the block fails, the folders down to ``out`` that it made go again, as far as they are
    empty."""
    new = [each for each in (out, *out.parents) if not each.exists()]
    try:
        yield
    except BaseException:
        for each in new:
            with suppress(OSError):
                each.rmdir()
        raise


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write ``content`` beside ``path``, see it on the disk, then give it its name.

    Inside `together` it gets its name with the others. Raises ComputationError where the disk does
    not take it.
    """
    place = _place(path)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        beside = place.with_name(f"{UNFINISHED}{os.getpid()}-{place.name}")
        try:
            with beside.open("wb") as file:
                file.write(content.encode() if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(place)
        except BaseException:
            beside.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise cannot_write(path, error) from error


@contextmanager
def folder_in_place(folder: Path) -> Iterator[Path]:
    """A new folder to fill, which takes the place of ``folder`` when the block ends well.

    Inside `together` it does so with the others.
    """
    waiting = _waiting_for(folder)
    with together(folder.parent if waiting is None else waiting.out):
        made = _place(folder)
        made.mkdir(parents=True)
        yield made
        remove(folder)


def remove(path: Path) -> None:
    """Remove a folder or file of an earlier result, if it is there; in `together`, at its end."""
    waiting = _waiting_for(path)
    if waiting is not None:
        waiting.gone.append(path)
    elif path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@dataclass
class _Waiting:
    """Files that wait in ``made`` for their places in ``out``, those named ``last`` at the end;
    before them what is ``gone`` leaves."""

    out: Path
    made: Path
    last: list[str]
    gone: list[Path] = field(default_factory=list)

    def place(self) -> None:
        new = sorted(path for path in self.made.rglob("*") if path.is_file())
        names = [path.relative_to(self.made) for path in new]
        for name in names:
            place = self.out / name
            if any(place.is_relative_to(each) for each in self.gone):
                continue
            if place.is_dir():
                raise IsADirectoryError(errno.EISDIR, f"{name} is a folder there", str(name))
            place.parent.mkdir(parents=True, exist_ok=True)
        names.sort(key=lambda name: str(name) in self.last)
        old = self.made / UNFINISHED
        old.mkdir()
        with uninterrupted():
            for i, path in enumerate(self.gone):
                if path.exists():
                    path.replace(old / str(i))
            for name in names:
                (self.out / name).parent.mkdir(parents=True, exist_ok=True)
                (self.made / name).replace(self.out / name)
            shutil.rmtree(old, ignore_errors=True)


_open: list[_Waiting] = []


@contextmanager
def together(out: Path, *last: str) -> Iterator[None]:
    """What the block writes into ``out`` takes its place when the block ends well, else nothing.

    The files named ``last`` come last, since they say that all is there. A block inside another of
    the same folder joins it. Raises ComputationError where the disk does not take them.
    """
    for outer in _open:
        if outer.out == out:
            outer.last.extend(last)
            yield
            return
    try:
        with filled(out, *last):
            yield
    except OSError as error:
        raise cannot_write(out, error) from error


@contextmanager
def filled(out: Path, *last: str) -> Iterator[Path]:
    """`together` for those that write files themselves: into the folder that it gives."""
    waiting = _Waiting(out, Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=out)), list(last))
    _open.append(waiting)
    try:
        yield waiting.made
        waiting.place()
    finally:
        _open.remove(waiting)
        shutil.rmtree(waiting.made, ignore_errors=True)


def _waiting_for(path: Path) -> _Waiting | None:
    return next((each for each in reversed(_open) if path.is_relative_to(each.out)), None)


def _place(path: Path) -> Path:
    """Where a file is written to, for now."""
    waiting = _waiting_for(path)
    if waiting is None or path.is_relative_to(waiting.made):
        return path
    return waiting.made / path.relative_to(waiting.out)


def cannot_write(path: Path, error: OSError) -> ComputationError:
    """What is said where the disk is full, or may not be written."""
    return ComputationError(f"{path}: cannot be written: {error.strerror or error}")


def write_json(path: Path, document: Any) -> None:
    """Write a document as `to_json` has it, atomically."""
    write_atomically(path, to_json(document) + "\n")


def to_json(document: Any, indent: int | None = 2) -> str:
    """JSON without NaN or Infinity: null stands for what is no number, "inf" for infinity."""
    return json.dumps(_plain(document), indent=indent, allow_nan=False, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0 else "-inf"
    if hasattr(value, "item"):
        return _plain(value.item())
    return value


def to_csv(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table with a head; numbers in full, None and NaN left empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(value) for value in row] for row in rows)
    return text.getvalue()


def read_csv(path: Path) -> list[dict[str, str]]:
    """The rows of a table by column, as `to_csv` wrote them."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(float(value))
    return "" if value is None else value
