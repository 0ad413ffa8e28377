"""What is derived from the declared inputs: types of the Python functions, tables of options.

    docker/run python3 tests/derived.py

writes ``docker/live/bristle/__init__.pyi`` and the tables in ``docs/inputs.md``. A test says when
this is due.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from pathlib import Path

import bristle
from bristle.studies.api import SIGNATURES, Session
from bristle.studies.api.signatures import type_text
from bristle.studies.inputs.brush_fields import BRUSH_OWN_FLAGS
from bristle.studies.inputs.fields import DROP_FLAGS, LIST_FLAGS
from bristle.studies.inputs.flags import Flag
from bristle.studies.inputs.study_fields import (
    CALIBRATE_FLAGS,
    LOOP_FLAGS,
    OWN_FLAGS,
    SYNTH_FLAGS,
    TRACK_FLAGS,
)

ROOT = Path(__file__).parents[1]
STUB = ROOT / "docker" / "live" / "bristle" / "__init__.pyi"
INPUTS = ROOT / "docs" / "inputs.md"
TABLES = {
    "drop": DROP_FLAGS,
    "lists": LIST_FLAGS,
    "scatter": OWN_FLAGS,
    "brush": BRUSH_OWN_FLAGS,
    "calibrate": CALIBRATE_FLAGS,
    "loop": LOOP_FLAGS,
    "synth": SYNTH_FLAGS,
    "track": TRACK_FLAGS,
}
HEAD = '''\
"""Types of `import bristle`. Written by tests/derived.py from the declared inputs; do not edit."""

from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from mpi4py import MPI
from pandas import DataFrame

from .solver.effects.base import Effect as Effect
from .solver.errors import ComputationError as ComputationError
from .solver.errors import InputError as InputError
from .studies import __version__ as __version__
from .studies.api import BristleWarning as BristleWarning
'''
SESSION = """
class Session:
    comm: MPI.Intracomm
    def __init__(self, comm: MPI.Intracomm | None = None) -> None: ...
    def __enter__(self) -> Self: ...
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...
    def close(self) -> None: ...
"""


def stub() -> str:
    """The text of `STUB`."""
    records = [each for each in bristle.__all__ if each[0].isupper() and each not in HEAD]
    records.remove("Session")
    parts = [HEAD + "".join(f"from .studies.api import {each} as {each}\n" for each in records)]
    functions = [*SIGNATURES, "view"]
    parts += [_declared(name, inspect.signature(getattr(bristle, name))) for name in functions]
    methods = (_declared(name, inspect.signature(getattr(Session, name)), 4) for name in SIGNATURES)
    return "".join([*parts, SESSION, *(each.removeprefix("\n") for each in methods)])


def _declared(name: str, signature: inspect.Signature, indent: int = 0) -> str:
    """A function as a stub has it, a line for each parameter."""
    lines, keyword = [], False
    for each in signature.parameters.values():
        if each.kind is inspect.Parameter.KEYWORD_ONLY and not keyword:
            lines.append("*,")
            keyword = True
        annotation = each.annotation
        text = type_text(annotation) if not isinstance(annotation, str) else annotation
        text = text.replace("Folder", "str | Path")
        typed = each.name if each.name == "self" else f"{each.name}: {text}"
        empty = each.default is inspect.Parameter.empty
        lines.append(f"{typed}," if empty else f"{typed} = {each.default!r},")
    found = signature.return_annotation
    returned = found if isinstance(found, str) else type_text(found)
    body = "".join(f"    {line}\n" for line in lines)
    text = f"\ndef {name}(\n{body}) -> {returned}: ...\n"
    return re.sub(r"(?m)^(?=.)", " " * indent, text)


def table(flags: Iterable[Flag]) -> str:
    """Flags as a table: how the command line and Python call them, default, meaning."""
    rows = ["| option | in Python | default | meaning |", "|---|---|---|---|"]
    for flag in flags:
        cells = (f"`{flag.option}`", f"`{flag.field}`", flag.default_text(), flag.help)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def with_tables(page: str) -> str:
    """A page with its tables of options as the program declares them."""
    for name, flags in TABLES.items():
        mark = f"<!-- options: {name} -->"
        assert page.count(mark) == 1, mark
        # a function, since the text of a table may have backslashes
        page = re.sub(rf"{mark}\n\n(\|.*\n)*", lambda _: f"{mark}\n\n{table(flags)}\n", page)  # noqa: B023
    return page


def main() -> None:
    """Write all of it."""
    STUB.write_text(stub(), encoding="utf-8")
    INPUTS.write_text(with_tables(INPUTS.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
