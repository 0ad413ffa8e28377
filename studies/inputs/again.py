"""The command line that makes a result again."""

from __future__ import annotations

import shlex
from pathlib import Path

from pydantic import BaseModel

from .sources import OPTIONS


def command_line(name: str, inputs: BaseModel, usual: BaseModel, out: Path) -> str:
    """``bristle NAME`` with what differs from the ``usual`` inputs, and its folder."""
    words = [name]
    for field, option in OPTIONS.items():
        value = getattr(inputs, field, None)
        if field not in type(inputs).model_fields or value in (None, getattr(usual, field)):
            continue
        if isinstance(value, bool):
            words.append(option)
        elif isinstance(value, tuple) and field != "cells":
            words += [option, ",".join(map(str, value))]
        else:
            words += [option, *map(str, value if isinstance(value, tuple) else (value,))]
    return into(out, *words)


def into(out: Path, *words: object) -> str:
    """``bristle WORDS`` into the folder ``out``, as a shell takes it."""
    return shlex.join(["bristle", *map(str, words), "--out", str(out)])
