"""How does a file come to its place whole, or not at all?"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...solver.errors import InputError

if TYPE_CHECKING:
    from ..page.figures import Picture


# How the names of things begin until they are whole.
UNFINISHED = ".bristle-unfinished-"


def prepare_folder(out: Path) -> None:
    """Make ``out`` where it is missing; InputError where it is a file or cannot be written.

    What a run that was killed left there unfinished is removed.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        for path in out.iterdir():
            if path.name.startswith(UNFINISHED):
                remove_folder(path) if path.is_dir() else path.unlink(missing_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"--out {out}: there is a file of that name, not a folder") from None
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror}") from error


def prepare_folder_together(out: Path) -> None:
    """`prepare_folder` by rank 0 of all of them; raises the same error on each."""
    from mpi4py import MPI

    from ...meshes.collective import run_on_one_rank

    run_on_one_rank(MPI.COMM_WORLD, lambda: prepare_folder(out))


def write_picture(stem: Path, drawn: Picture) -> list[str]:
    """Write ``stem``.svg and ``stem``.png; returns their names."""
    files = {f"{stem.name}.svg": drawn.svg.encode(), f"{stem.name}.png": drawn.png}
    for name, content in files.items():
        write_atomically(stem.parent / name, content)
    return list(files)


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write ``content`` beside ``path``, see it on the disk, then give it its name."""
    handle, name = tempfile.mkstemp(prefix=f"{UNFINISHED}{path.name}-", dir=path.parent)
    beside = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        beside.chmod(0o666 & ~_umask())
        beside.replace(path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


@contextmanager
def folder_in_place(folder: Path) -> Iterator[Path]:
    """A new folder to fill, which takes the place of ``folder`` when the block ends well."""
    made = Path(tempfile.mkdtemp(prefix=f"{UNFINISHED}{folder.name}-", dir=folder.parent))
    try:
        made.chmod(0o777 & ~_umask())
        yield made
        if folder.exists():
            old = Path(tempfile.mkdtemp(prefix=f"{UNFINISHED}{folder.name}-", dir=folder.parent))
            folder.replace(old)
            made.replace(folder)
            shutil.rmtree(old, ignore_errors=True)
        else:
            made.replace(folder)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def remove_folder(folder: Path) -> None:
    """Remove a folder of an earlier result, if it is there."""
    shutil.rmtree(folder, ignore_errors=True)


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


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(float(value))
    return "" if value is None else value


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
