"""Files that a user hands over, read as text, TOML or JSON.

Whatever it holds, it is read to an end or refused with an InputError that names file and line.
"""

from __future__ import annotations

import difflib
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from ...solver.errors import InputError

MOST_BYTES = 50_000_000
MOST_SHOWN = 80


def exists(path: Path) -> bool:
    """Whether there is such a file; there is none where there cannot be one of that name."""
    try:
        path.stat()
    except (OSError, ValueError):
        return False
    return True


def read_text(path: Path) -> str:
    """The text of a file, or of a pipe that ends, without a byte order mark; InputError."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise InputError(f"{path}: cannot be read: larger than {MOST_BYTES // 1_000_000} MB")
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read: it is not text in UTF-8") from error
    except (OSError, ValueError) as error:  # a name with a zero byte is a ValueError
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: cannot be read: {reason}") from error


def finite(value: object) -> float | None:
    """What a tree has for a number, or None where it is none, or not finite."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def printable(text: str) -> str:
    """A text on one line, with escapes for what would steer a terminal or cannot be encoded."""
    return "".join(
        letter if letter.isprintable() else ascii(letter)[1:-1] for letter in " ".join(text.split())
    )


def hints(name: str, known: Iterable[str]) -> list[str]:
    """What a misspelt name may have meant, in words; empty where nothing is near."""
    return [f"did you mean {near}?" for near in difflib.get_close_matches(name, list(known), 1)]


def quoted(value: object) -> str:
    """A value as an error shows it: on one line that can be read."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a whole number of thousands of digits
        return "a value too long to show"
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]} …"


def line_of(text: str, key: str) -> int | None:
    """The line of a TOML text, from 1, on which ``key`` is set or opens a table."""
    name = rf"[\"']?{re.escape(key)}[\"']?"
    setting = re.compile(rf"^\s*(\[+\s*{name}\s*[\].]|{name}\s*[=.:])")
    return next((n for n, line in enumerate(text.splitlines(), 1) if setting.match(line)), None)


def parse_toml(path: Path, text: str) -> dict[str, Any]:
    """The tree of a TOML text that was read from ``path``."""
    return _parsed(path, text, "TOML", tomllib.loads)


def parse_json(path: Path, text: str) -> Any:
    """What a JSON text says that was read from ``path``."""
    return _parsed(path, text, "JSON", json.loads)


def _parsed[Tree](path: Path, text: str, language: str, parse: Callable[[str], Tree]) -> Tree:
    try:
        return parse(text)
    except json.JSONDecodeError as error:
        line, reason = error.lineno, error.msg
    except RecursionError:
        line, reason = 1, "tables and lists are nested too deeply"
    except ValueError as error:  # also a whole number of thousands of digits
        place = re.search(r"\(at line (\d+), column \d+\)", str(error))
        line = int(place.group(1)) if place else text.count("\n") + 1
        reason = re.sub(r" \(at .*\)$", "", str(error)).partition(";")[0]
    raise InputError(f"{path}:{line}: not valid {language}: {reason}")
