"""Which cases of a study are done, when it is taken up again after an interruption?

One JSON line per finished case, on the disk before the next is begun. The first line holds the
version and the inputs; a last line that is torn counts for nothing.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from .. import __version__
from .files import to_json, write_atomically
from .results import check_same, plain_inputs

JOURNAL, PREVIOUS = "cases.jsonl", "cases.previous.jsonl"


class Journal:
    """The finished cases of a study in the folder ``out``, by their number in its list."""

    def __init__(self, out: Path, inputs: BaseModel) -> None:
        self.path, self.previous = out / JOURNAL, out / PREVIOUS
        self._inputs = inputs

    def begin(self) -> None:
        """Start anew; the journal that was there is kept until `finish`."""
        if self.path.exists():
            self.path.replace(self.previous)
        self._write([])

    def resume(self) -> dict[int, dict[str, Any]]:
        """What is done already, by number; InputError where it was done with other inputs."""
        lines = _whole_lines(self.path)
        if not lines:
            self.begin()
            return {}
        check_same(self.path, lines[0], self._inputs)
        self._write(lines[1:])
        return {line["case"]: line["found"] for line in lines[1:]}

    def add(self, number: int, found: dict[str, Any]) -> None:
        """Note a finished case."""
        line = to_json({"case": number, "found": found}, indent=None) + "\n"
        with self.path.open("a", encoding="utf-8") as file:
            file.write(line)
            file.flush()
            os.fsync(file.fileno())

    def finish(self) -> None:
        """Give up what an earlier study left: this one's results are complete."""
        self.previous.unlink(missing_ok=True)

    def _write(self, lines: list[dict[str, Any]]) -> None:
        head = {"version": __version__, "inputs": plain_inputs(self._inputs)}
        text = "".join(to_json(line, indent=None) + "\n" for line in [head, *lines])
        write_atomically(self.path, text)


def _whole_lines(path: Path) -> list[dict[str, Any]]:
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    lines: list[dict[str, Any]] = []
    for line in text.splitlines():
        try:
            lines.append(json.loads(line))
        except json.JSONDecodeError:
            break
    return lines
