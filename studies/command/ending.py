"""How does a command end: with which exit status, and which last line on standard error?"""

from __future__ import annotations

import re
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

import click

from ...solver.errors import BristleError
from ..running.parallel import Ending, Ranks, rank_0_speaks

INTERRUPTED = 130


def run(command: click.Command, arguments: list[str]) -> int:
    """Run ``command``; returns the exit status, the same on every rank.

    0 done, 1 the computation failed, 2 the input is wrong, 130 interrupted. An error ends with one
    line on standard error, from rank 0 alone unless another rank fails by itself.
    """
    with rank_0_speaks(), _terminable():
        ranks = Ranks()
        try:
            ending = _attempt(command, arguments)
        except KeyboardInterrupt:
            ending = Ending(INTERRUPTED, "bristle: interrupted")
        return ranks.finish(ending)


def _attempt(command: click.Command, arguments: list[str]) -> Ending:
    debug = "--debug" in arguments
    try:
        status = command.main(arguments, prog_name="bristle", standalone_mode=False)
        sys.stdout.flush()
    except BristleError as error:
        return _failed(error.exit_status, str(error), debug)
    except click.ClickException as error:
        return _failed(2, _usage(error), debug)
    except click.Abort:
        raise KeyboardInterrupt from None
    except BrokenPipeError:
        sys.stdout = None  # whoever read it has gone: no use to flush it at exit
        return Ending(1, "bristle: error: standard output was closed before the end")
    except OSError as error:
        return _failed(1, f"{error.filename or 'file'}: {error.strerror or error}", debug)
    except MemoryError:
        return _failed(1, "there is not enough memory; take fewer --cells or more ranks", debug)
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        return _failed(1, text if debug else f"{text} (unexpected: --debug shows where)", debug)
    return Ending(status if isinstance(status, int) else 0, _interruption(status))


def _interruption(status: object) -> str:
    return "bristle: interrupted" if status == INTERRUPTED else ""


def _failed(status: int, message: str, debug: bool) -> Ending:
    line = f"bristle: error: {' '.join(message.split())}"
    return Ending(status, f"{traceback.format_exc()}{line}" if debug else line)


def _usage(error: click.ClickException) -> str:
    """Click's complaint as ``--option: what is wrong``."""
    if isinstance(error, click.NoSuchOption):
        near = f"; did you mean {error.possibilities[0]}?" if error.possibilities else ""
        return f"{error.option_name}: there is no such option{near}"
    message = error.format_message().rstrip(".")
    message = re.sub(r"^Invalid value for '([^']+)': ", r"\1: ", message)
    message = re.sub(r"^Missing argument '([^']+)'$", r"\1: is missing", message)
    message = re.sub(r"^Option '([^']+)' requires", r"\1: requires", message)
    message = re.sub(
        r"^Got unexpected extra arguments? \((.*)\)$", r"\1: not expected here", message
    )
    return re.sub(r"^No such command '(.*)'$", r"\1: there is no such command", message)


@contextmanager
def _terminable() -> Iterator[None]:
    """A polite end (SIGTERM, as mpirun sends it) cleans up like one from the keyboard."""

    def stop(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # not in the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
