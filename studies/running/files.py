"""Files and folders written whole and together, or not at all."""

from __future__ import annotations

import csv
import io
import json
import math
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...solver.errors import ComputationError, InputError
from .interrupts import uninterrupted
from .mark import MARK, UNFINISHED, Mark, digest, lock_folder, refuse_foreign, write_out


def prepare_folder(out: Path, *names: str) -> None:
    """Make ``out`` where it is missing; InputError where it is a file or cannot be written, or one
    of ``names`` there is not the program's (`refuse_foreign`).

    What a run that was killed left there unfinished is removed; one that still writes there is
    waited for (`lock_folder`).
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock_folder(out)
        for path in out.glob(f"{UNFINISHED}*"):
            if (path / MARK).exists() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            with suppress(OSError):  # one that was killed before it wrote anything
                path.rmdir()
        with tempfile.TemporaryFile(dir=out):
            pass
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"--out {out}: there is a file of that name, not a folder") from None
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror}") from error
    refuse_foreign(out, *names)


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
    """Write ``content``, see it on the disk, then give it its name; inside `together` it gets that
    with the others.

    Raises ComputationError where the disk does not take it, InputError where ``path`` is there and
    not the program's.
    """
    with together(path.parent):
        try:
            place = _place(path)
            place.parent.mkdir(parents=True, exist_ok=True)
            write_out(place, content)
        except OSError as error:
            raise cannot_write(path, error) from error


@contextmanager
def folder_in_place(folder: Path) -> Iterator[Path]:
    """A new folder to fill, which takes the place of ``folder`` when the block ends well.

    Inside `together` it does so with the others. What the user added to the old one stays.
    """
    with together(folder.parent):
        made = _place(folder)
        made.mkdir(parents=True)
        yield made
        remove(folder)


def remove(*paths: Path) -> None:
    """Remove what the program wrote of an earlier result, files or the files of folders, at the end
    of the block of `together`: those that are not written anew in it."""
    for path in paths:
        with together(path.parent):
            _waiting_for(path).gone.append(path)


@dataclass
class _Waiting:
    """Files that wait in ``made`` for their places in ``out``, those named ``last`` at the end;
    before them what is ``gone`` leaves, by way of ``aside``."""

    out: Path
    made: Path
    aside: Path
    last: list[str]
    gone: list[Path] = field(default_factory=list)

    def place(self) -> None:
        mark = Mark.read(self.out)
        new = sorted(path for path in self.made.rglob("*") if path.is_file())
        names = [path.relative_to(self.made).as_posix() for path in new]
        for name in names:
            mark.check(name)
            (self.out / name).parent.mkdir(parents=True, exist_ok=True)
        gone = [name for name in mark.below(self.gone) if not (self.made / name).exists()]
        mark.add({name: digest(self.made / name) for name in names})
        names.sort(key=lambda name: name in self.last)
        self.aside.mkdir()
        with uninterrupted():
            mark.write()
            for i, name in enumerate(gone):
                (self.out / name).replace(self.aside / str(i))
            for name in names:
                (self.made / name).replace(self.out / name)
            left = {parent for name in gone for parent in Path(name).parents[:-1]}
            for folder in sorted(left, reverse=True):
                with suppress(OSError):  # one that is not empty
                    (self.out / folder).rmdir()


_open: list[_Waiting] = []


@contextmanager
def together(out: Path, *last: str) -> Iterator[None]:
    """What the block writes into ``out`` takes its place when the block ends well, else nothing.

    The files named ``last`` come last, since they say that all is there. A block inside another of
    the same folder, or one around it, joins it. Raises ComputationError where the disk does not
    take them, InputError where one would replace what is not the program's.
    """
    for outer in reversed(_open):
        if out.is_relative_to(outer.out):
            outer.last.extend((out / name).relative_to(outer.out).as_posix() for name in last)
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
    out.mkdir(parents=True, exist_ok=True)
    staging = out / Path(tempfile.mkdtemp(prefix=UNFINISHED, dir=out)).name
    waiting = _Waiting(out, staging / "made", staging / "aside", list(last))
    _open.append(waiting)
    try:
        (staging / MARK).touch()
        waiting.made.mkdir()
        yield waiting.made
        waiting.place()
    finally:
        _open.remove(waiting)
        shutil.rmtree(staging, ignore_errors=True)


def _waiting_for(path: Path) -> _Waiting:
    """The block that ``path`` is written in."""
    return next(each for each in reversed(_open) if path.is_relative_to(each.out))


def _place(path: Path) -> Path:
    """Where a file is written to, for now."""
    waiting = _waiting_for(path)
    if path.is_relative_to(waiting.made):
        return path
    return waiting.made / path.relative_to(waiting.out)


def cannot_write(path: Path, error: OSError) -> ComputationError:
    """What is said where the disk is full, or may not be written."""
    return ComputationError(f"{path}: cannot be written: {error.strerror or error}")


def write_json(path: Path, document: Mapping[str, Any]) -> dict[str, Any]:
    """Write a result as `to_json` has it, atomically. It names the folder's mark; returns it."""
    named = {**document, "mark": MARK}
    write_atomically(path, to_json(named) + "\n")
    return named


def to_json(document: Any) -> str:
    """JSON without NaN or Infinity: null stands for what is no number, "inf" for infinity."""
    return json.dumps(to_plain(document), indent=2, allow_nan=False, ensure_ascii=False)


def to_plain(value: Any) -> Any:
    """A value as `to_json` writes it."""
    if isinstance(value, dict):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0 else "-inf"
    if hasattr(value, "item"):
        return to_plain(value.item())
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
