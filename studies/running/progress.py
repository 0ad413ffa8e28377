"""How does a user see that long work goes on: a bar on a terminal, plain lines elsewhere?"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from .parallel import speaks

PLAIN_EVERY_S = 10.0


@contextmanager
def progress(title: str, total: int, *, done: int = 0) -> Iterator[Callable[[], None]]:
    """A function to call once per finished piece of ``total``, of which ``done`` are already."""
    if not speaks():
        yield lambda: None
    elif sys.stderr.isatty():
        with _bar(title, total, done) as advance:
            yield advance
    else:
        yield _Lines(title, total, done).advance


@contextmanager
def _bar(title: str, total: int, done: int) -> Iterator[Callable[[], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total, completed=done)
        yield lambda: bar.advance(task)


class _Lines:
    """A line at the start, at the end, and every ten seconds between."""

    def __init__(self, title: str, total: int, done: int) -> None:
        self.title, self.total, self.done = title, total, done
        self._say()

    def advance(self) -> None:
        self.done += 1
        if self.done == self.total or time.monotonic() - self._said > PLAIN_EVERY_S:
            self._say()

    def _say(self) -> None:
        note(f"{self.title}: {self.done} of {self.total}")
        self._said = time.monotonic()


@contextmanager
def working(title: str) -> Iterator[None]:
    """Say what is under way while the block runs."""
    if speaks() and sys.stderr.isatty():
        from rich.console import Console

        with Console(stderr=True).status(title):
            yield
    else:
        note(f"{title} …")
        yield


def say(message: str) -> None:
    """A line on standard output, from rank 0."""
    if speaks():
        print(message, flush=True)


def note(message: str) -> None:
    """A line on standard error, from rank 0."""
    if speaks():
        print(message, file=sys.stderr, flush=True)


def warn(message: str) -> None:
    """A warning on standard error."""
    note(f"bristle: warning: {message}")
