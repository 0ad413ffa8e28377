"""Progress of long work: a bar on a terminal, lines of the log elsewhere."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from .parallel import speaks

PLAIN_EVERY_S = 10.0
# A share of the work that says nothing yet of how long all of it takes.
EARLY = 0.1
LOG = logging.getLogger("bristle")


@contextmanager
def progress(
    title: str, total: int, *, done: int = 0, alike: bool = True
) -> Iterator[Callable[..., None]]:
    """A function to call for each finished piece of ``total``, of which ``done`` are already.

    It takes how many they are, where it is not one, and a few words on how things stand. Both forms
    tell the time that is left, where the pieces are ``alike``; a bar also the time that is spent,
    which goes on while the first piece is prepared.
    """
    if not speaks():
        yield lambda count=1, words="": None
    elif sys.stderr.isatty():
        with _bar(title, total, done, alike) as advance:
            yield advance
    else:
        yield _Lines(title, total, done, alike).advance


@contextmanager
def _bar(title: str, total: int, done: int, alike: bool) -> Iterator[Callable[..., None]]:
    from rich import progress as rich
    from rich.console import Console
    from rich.text import Text

    class Remaining(rich.TimeRemainingColumn):
        def render(self, task: rich.Task) -> Text:
            return super().render(task) if task.percentage >= 100.0 * EARLY else Text("-:--:--")

    left = ("left", Remaining()) if alike else ()
    counted = (rich.BarColumn(), rich.MofNCompleteColumn(), rich.TimeElapsedColumn(), *left)
    columns = ("{task.description}", *counted)
    with rich.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total, completed=done)

        def advance(count: int = 1, words: str = "") -> None:
            bar.update(task, advance=count, description=f"{title}, {words}" if words else title)

        yield advance


class _Lines:
    """A line at the start, at the end, and every ten seconds between."""

    def __init__(self, title: str, total: int, done: int, alike: bool) -> None:
        self.title, self.total, self.done, self.alike = title, total, done, alike
        self.words = ""
        self._first: tuple[float, int] | None = None
        self._say()

    def advance(self, count: int = 1, words: str = "") -> None:
        self.done, self.words = self.done + count, words and f", {words}"
        # what is built before the first is not what the others take
        self._first = self._first or (time.monotonic(), self.done)
        if self.done == self.total or time.monotonic() - self._said > PLAIN_EVERY_S:
            self._say()

    def _say(self) -> None:
        self._said = time.monotonic()
        words, left = "", self.total - self.done
        if self._first is not None and self.alike and left:
            began, before = self._first
            since = self.done - before
            if since >= EARLY * (self.total - before):
                words = f", {duration(left * (self._said - began) / since)} left"
        note(f"{self.title}: {self.done} of {self.total}{self.words}{words}")


def duration(seconds: float) -> str:
    """A time as a person says it, such as ``about 3 min``."""
    for size, unit in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"about {seconds / size:.0f} {unit}"
    return f"about {max(seconds, 1.0):.0f} s"


@contextmanager
def working(title: str) -> Iterator[None]:
    """Say what is under way while the block runs, and on a terminal for how long already."""
    if speaks() and sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import Progress, SpinnerColumn, TimeElapsedColumn

        columns = (SpinnerColumn(), "{task.description}", TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
            shown.add_task(title, total=None)
            yield
    else:
        note(f"{title} …")
        yield


@contextmanager
def compilation_noted() -> Iterator[None]:
    """Say once, where it happens while the block runs, that the compiler keeps the user waiting."""
    from numba.core import event as events

    class Once(events.Listener):
        def on_start(self, event: events.Event) -> None:
            if not notes:
                notes.append("compiling for this machine, minutes the first time …")
                note(notes[0])

        def on_end(self, event: events.Event) -> None:
            pass

    notes: list[str] = []
    with events.install_listener("numba:compile", Once()):
        yield


def say(message: str) -> None:
    """Log an answer, from rank 0; a command has it on standard output."""
    if speaks():
        LOG.info(message, extra={"answer": True})


def note(message: str) -> None:
    """Log what is under way, from rank 0; a command has it on standard error."""
    if speaks():
        LOG.info(message)


def warn(message: str) -> None:
    """Log a warning, from rank 0."""
    if speaks():
        LOG.warning(message)


class Terminal(logging.Handler):
    """What a command logs, as lines on its standard output and error."""

    def emit(self, record: logging.LogRecord) -> None:
        prefix = "bristle: warning: " if record.levelno >= logging.WARNING else ""
        stream = sys.stdout if hasattr(record, "answer") else sys.stderr
        print(f"{prefix}{record.getMessage()}", file=stream, flush=True)


@contextmanager
def logged_to_terminal() -> Iterator[None]:
    """Have what is logged inside the block on standard output and error."""
    handler, level = Terminal(), LOG.level
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)
