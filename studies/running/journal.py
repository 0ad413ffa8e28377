"""Journal of a study's finished cases, from which it is taken up again.

One JSON line per finished case, on the disk before the next is begun. The first line holds the
version and the inputs. Each has a checksum: one that is torn, or not what was written, counts for
nothing. Where cases have names, a study with other lists takes up those that it has too.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from ...solver.errors import InputError
from .files import cannot_write, prepare_folder, write_atomically
from .interrupts import uninterrupted
from .mark import claim, refuse_foreign
from .results import check_same, check_version, head, plain_inputs, read_document

SCHEMA, CHECK = "bristle-journal-3", "sha256"
JOURNAL, PREVIOUS = "cases.jsonl", "cases.previous.jsonl"


class Journal:
    """The finished cases of a study in the folder ``out``, by their number in its list.

    ``names`` tell a case from all that have another outcome, in this study or any other. Without
    them a case is known by its number, among the same inputs alone.
    """

    def __init__(self, out: Path, inputs: BaseModel, names: Sequence[str] | None = None) -> None:
        self.path, self.previous = out / JOURNAL, out / PREVIOUS
        self._inputs, self._names = inputs, names

    def prepare(
        self, document: str, *others: str, resume: bool
    ) -> dict[int, dict[str, Any]] | None:
        """Begin anew, or what is done already: None where the study's ``document`` is there.

        Raises InputError where what is to be resumed has other inputs and no case of these, or the
        document or one of the ``others`` that the study writes is there and not the program's.
        """
        out = self.path.parent
        prepare_folder(out)
        found = read_document(out / document) if resume else None
        if found is not None:
            check_version(out / document, found)
            if self._names is None or found["inputs"] == plain_inputs(self._inputs):
                check_same(out / document, found, self._inputs)
                return None
        refuse_foreign(out, JOURNAL, PREVIOUS, document, *others)
        if resume:
            return self.resume()
        self.begin()
        return {}

    def begin(self) -> None:
        """Start anew; the last journal with a finished case is kept until `finish`."""
        claim(self.path.parent, JOURNAL, PREVIOUS)
        if self.path.exists() and len(_whole_lines(self.path)) > 1:
            self.path.replace(self.previous)
        self._write([])

    def resume(self) -> dict[int, dict[str, Any]]:
        """What is done already, by number; InputError where all of it was done with other inputs,
        or what is there is no journal of this version, whose first line is always whole."""
        if not self.path.exists():
            self.begin()
            return {}
        lines = _whole_lines(self.path)
        if not lines or lines[0].get("schema") != SCHEMA:
            raise InputError(
                f"--resume {self.path}: is no {SCHEMA}, or its first line is damaged; "
                "choose another --out, or leave --resume out"
            )
        check_version(self.path, lines[0])
        noted = {line["case"]: line["found"] for line in lines[1:]}
        if self._names is not None:
            noted = {i: noted[name] for i, name in enumerate(self._names) if name in noted}
        if self._names is None or not noted:
            check_same(self.path, lines[0], self._inputs)
        self._write(lines[1:])
        return noted

    def add(self, number: int, found: dict[str, Any]) -> dict[str, Any]:
        """Note a finished case; what `resume` will say of it, so that both go on with the same.

        Raises ComputationError where the disk does not take it.
        """
        case = number if self._names is None else self._names[number]
        line = _line({"case": case, "found": found})
        try:
            with uninterrupted(), self.path.open("ab", buffering=0) as file:
                end = file.tell()
                try:
                    remaining = memoryview(line)
                    while remaining:  # what does not fit raises when it is tried again
                        remaining = remaining[file.write(remaining) :]
                    os.fsync(file.fileno())
                except OSError:
                    file.truncate(end)
                    raise
        except OSError as error:
            raise cannot_write(self.path, error) from error
        noted: dict[str, Any] = json.loads(line)["found"]
        return noted

    def finish(self) -> None:
        """Give up what an earlier study left: this one's results are complete."""
        self.previous.unlink(missing_ok=True)
        claim(self.path.parent)

    def _write(self, lines: list[dict[str, Any]]) -> None:
        whole = [head(self._inputs, SCHEMA), *lines]
        write_atomically(self.path, b"".join(map(_line, whole)))


def _line(content: dict[str, Any]) -> bytes:
    """A line with the checksum of all else in it; infinity stays a number, unlike in results."""
    plain = json.loads(json.dumps(content, default=lambda array: array.tolist()))
    return json.dumps({**plain, CHECK: _digest(plain)}).encode() + b"\n"


def _digest(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


def _whole_lines(path: Path) -> list[dict[str, Any]]:
    """Lines that are what was written."""
    lines: list[dict[str, Any]] = []
    for line in path.read_bytes().split(b"\n"):
        try:
            found = json.loads(line)
            check = found.pop(CHECK)
            if check == _digest(found):
                lines.append(found)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
    return lines
