"""How a command ends: its exit status, and its last line on standard error."""

from __future__ import annotations

import atexit
import errno
import gc
import os
import re
import signal
import sys
import traceback
from io import TextIOWrapper

import click

from ...solver.errors import BristleError
from ..inputs.texts import hints, printable
from ..running.interrupts import INTERRUPTED, SIGNALS, heard, interruptible, leave
from ..running.mark import locks
from ..running.parallel import Ending, Ranks, rank_0_speaks
from ..running.progress import logged_to_terminal

LONGEST = 1000
INTERRUPTION = Ending(INTERRUPTED, "bristle: interrupted")


def run(command: click.Command, arguments: list[str]) -> int:
    """Run ``command``; returns the exit status, the same on every rank.

    0 done, 1 the computation failed, 2 the input is wrong, 130 interrupted. An error ends with one
    line on standard error, from rank 0 alone unless another rank fails by itself.
    """
    _open_streams()
    with interruptible(), rank_0_speaks(), logged_to_terminal(), locks():
        ranks = Ranks()
        try:
            ending = _attempt(command, arguments)
        except KeyboardInterrupt:
            heard()
            ending = INTERRUPTION
        status = ranks.finish(ending)
    if ranks.alone:
        leave(status)
    return status


@atexit.register
def _end_quietly() -> None:
    """What has ended is not interrupted, nor searched for cycles (a third of a second)."""
    gc.freeze()
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _attempt(command: click.Command, arguments: list[str]) -> Ending:
    debug = "--debug" in arguments
    try:
        status = command.main(arguments, prog_name="bristle", standalone_mode=False)
        sys.stdout.flush()
    except BristleError as error:
        return _failed(error.exit_status, _with_options(error), debug)
    except click.ClickException as error:
        return _failed(2, _usage(error), debug)
    except click.Abort:
        raise KeyboardInterrupt from None
    except (BrokenPipeError, SystemExit):  # the latter by click, into a pipe that nobody reads
        return _deaf("standard output was closed before the end", debug)
    except OSError as error:
        if error.filename is None:
            return _deaf(f"standard output: {error.strerror or error}", debug)
        status = 2 if error.errno == errno.ENAMETOOLONG else 1
        return _failed(status, f"{error.filename or 'file'}: {error.strerror or error}", debug)
    except MemoryError:
        return _failed(1, "there is not enough memory; take fewer --cells or more ranks", debug)
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        return _failed(1, text if debug else f"{text} (unexpected: --debug shows where)", debug)
    if status == INTERRUPTED:
        return INTERRUPTION
    return Ending(status if isinstance(status, int) else 0)


def _open_streams() -> None:
    """Have streams that take whatever is said, also where the user closed them (>&-)."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _deaf(message: str, debug: bool) -> Ending:
    """The end of a command that nobody reads; there is nothing left to flush at exit."""
    ending = _failed(1, message, debug)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno() if sys.__stdout__ else 1)
    return ending


def _failed(status: int, message: str, debug: bool) -> Ending:
    """An error on one line that a screen can hold, if with its two ends alone."""
    line = printable(message)
    if len(line) > LONGEST:
        line = f"{line[: LONGEST // 2]} … {line[-LONGEST // 2 :]}"
    line = f"bristle: error: {line}"
    return Ending(status, f"{traceback.format_exc()}{line}" if debug else line)


def _with_options(error: BristleError) -> str:
    """The message, and the options that set the inputs which it is about."""
    from ..inputs.sources import OPTIONS

    named = ", ".join(OPTIONS.get(name, name) for name in error.inputs)
    return f"{error} ({named})" if named else str(error)


def _remedy(error: click.NoSuchOption) -> str:
    """What an unknown option may have meant, or the commands that have it."""
    name = error.option_name
    for each in error.possibilities or ():
        if hints(name.lstrip("-"), [each.lstrip("-")]):  # click finds dashes alike too
            return f"; did you mean {each}?"
    every = error.ctx.find_root().command if error.ctx else None
    commands = every.commands.values() if isinstance(every, click.Group) else ()
    others = [str(each.name) for each in commands if any(name in one.opts for one in each.params)]
    return f" here, only in {', '.join(others)}" if others else ""


def _usage(error: click.ClickException) -> str:
    """Click's complaint as ``--option: what is wrong``."""
    if isinstance(error, click.NoSuchOption):
        return f"{error.option_name}: there is no such option{_remedy(error)}"
    message = error.format_message().rstrip(".")
    message = re.sub(r"^Invalid value for '([^']+)': ", r"\1: ", message)
    message = re.sub(r"^Missing argument '([^']+)'$", r"\1: is missing", message)
    message = re.sub(r"^Option '([^']+)' requires", r"\1: requires", message)
    message = re.sub(
        r"(?s)^Got unexpected extra arguments? \((.*)\)$", r"\1: not expected here", message
    )
    return re.sub(r"(?s)^No such command '(.*)'$", r"\1: there is no such command", message)
