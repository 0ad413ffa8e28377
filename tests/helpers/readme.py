"""What README and the documents say: commands, the output under them, marked numbers and tables.

A number that a test checks has a mark right after it, ``0.65<!-- measured-mean -->``. A table has
one in the line before, ``<!-- table: leaning -->``. Sentences around them are free to change.
"""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from bristle.studies.cli import app, main

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = [
    *(REPOSITORY / name for name in ("README.md", "CONTRIBUTING.md")),
    *sorted((REPOSITORY / "docs").glob("*.md")),
]
TEXT = "\n".join(path.read_text(encoding="utf-8") for path in PAGES)
FENCE = re.compile(r"^( *)```(\w+)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
MARK = re.compile(rf"({NUMBER.pattern})<!-- ([\w-]+) -->")
MARK_OF_A_TABLE = re.compile(r"^ *<!-- table: ([\w-]+) -->\n((?: *\|.*\n)+)", re.MULTILINE)
GROUP: click.Group = app


def blocks(language: str) -> list[str]:
    """The fenced blocks of a language, without their indentation."""
    return [textwrap.dedent(body) for _, name, body in FENCE.findall(TEXT) if name == language]


@dataclass(frozen=True)
class Session:
    """A command and the lines that the README shows of what it prints."""

    words: tuple[str, ...]
    lines: tuple[str, ...]


def sessions() -> list[Session]:
    """Every console block."""
    found = []
    for block in blocks("console"):
        command, *lines = block.splitlines()
        found.append(Session(words_of(command.removeprefix("$ ")), tuple(lines)))
    return found


def commands() -> list[tuple[str, ...]]:
    """The words of every command, of shell blocks and of consoles."""
    lines = [line for block in blocks("sh") for line in block.splitlines() if line.strip()]
    return [*map(words_of, lines), *(session.words for session in sessions())]


def words_of(line: str) -> tuple[str, ...]:
    """A command line's words without its comment and the call of the environment."""
    words = shlex.split(line, comments=True)
    return tuple(words[1:] if words[0] == "docker/run" else words)


def without_ranks(words: tuple[str, ...]) -> tuple[int, tuple[str, ...]]:
    """On how many ranks a command runs, and the command."""
    if words[0] != "mpirun":
        return 1, words
    assert words[1] == "-n"
    return int(words[2]), words[3:]


def parse(words: tuple[str, ...]) -> click.Context:
    """The words after `bristle`, as the command line takes them; raises click's exceptions."""
    root = click.Context(GROUP, info_name="bristle")
    command = GROUP.get_command(root, words[0])
    assert command is not None, f"there is no bristle {words[0]}"
    return command.make_context(words[0], list(words[1:]), parent=root)


def options() -> set[str]:
    """Every option of every command."""
    return {
        option
        for command in (GROUP, *GROUP.commands.values())
        for parameter in command.params
        for option in (*parameter.opts, *parameter.secondary_opts)
    }


def number(name: str) -> str:
    """The number that bears a mark, as it is written."""
    (found,) = [shown for shown, mark in MARK.findall(_marked()) if mark == name]
    return found


def table(name: str) -> list[list[str]]:
    """The rows below the head of the table that bears a mark."""
    (found,) = [body for mark, body in MARK_OF_A_TABLE.findall(_marked()) if mark == name]
    return [
        [cell.strip() for cell in line.strip().strip("|").split("|")]
        for line in found.splitlines()[2:]
    ]


def marks() -> list[str]:
    """Every mark, in whatever form: those that `number` and `table` do not read too."""
    return re.findall(r"<!-- (?:table: )?([^>]*?) -->", _marked())


def _marked() -> str:
    """The text without what stands in code, where marks are explained."""
    return re.sub(r"`[^`\n]*<!--[^`\n]*`", "", TEXT)


def differences(shown: str, printed: str) -> list[str]:
    """Where a line differs from what the README shows of it: words, or a number by more than one
    in the last digit shown."""
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return [f"README: {shown!r}, now: {printed!r}"]
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return [f"{shown!r}: now {b}" for a, b in pairs if not agree(a, float(b))]


def agree(shown: str, value: float) -> bool:
    """Whether a number is the one that is shown, to one in its last digit."""
    return abs(float(shown) - value) <= 1.0001 * last_digit(shown)


def last_digit(shown: str) -> float:
    """What one in the last digit of a number is worth."""
    mantissa, _, exponent = shown.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def run(session: Session, folder: Path, words: Sequence[str] = ()) -> list[str]:
    """How what a session's command prints in a folder, or the command of other ``words``, differs
    from what is shown of it."""
    said = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(said):
        assert main(list(words or session.words[1:])) == 0
    return compare(session, said.getvalue())


def compare(session: Session, output: str) -> list[str]:
    """How the output of a session's command differs from what is shown of it."""
    printed: dict[str, list[str]] = {}
    for line in output.splitlines():
        printed.setdefault(line[:24].strip(), []).append(line)
    found = []
    for line in session.lines:
        name = line[:24].strip()
        lines = printed.get(name)  # of one name there may be several, such as doubts
        found += differences(line, lines.pop(0)) if lines else [f"{name}: not printed"]
    return found
