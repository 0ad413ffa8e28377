"""Interruption by Ctrl-C, SIGTERM or a terminal that closes.

At once, by a KeyboardInterrupt that cleans up; but not while files take their places, and not once
more while it cleans up: launchers, and `timeout`, send their signal twice.

A signal that came during compiled code reaches Python first where that code calls it back. There
nothing may be raised: numba's boxing goes on with what it then lacks, which ends the process, and
LLVM loses it. So the frames of such calls are known here, and what was to be raised is raised on
the next line, by a trace. No plainer way serves: a timer that tries again finds a loop of compiled
calls in the next one, each time; held back during such calls, an interruption would wait for
minutes of compilation; a handler that ends the process leaves children, terminal and temporary
files as they are.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 130
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Signals within this time are one.
ONE_S = 1.0
# The last one is obeyed without cleaning up.
MOST = 3
PETSC_OPTIONS, NO_HANDLER = "PETSC_OPTIONS", "-no_signal_handler"
# Of computing, until it is tried again where it cannot be obeyed, or was not heard.
AGAIN_S, UNHEARD_S = 0.05, 3.0


class _Signals:
    """What came so far, and whether it has to wait."""

    def __init__(self) -> None:
        self.count, self.last_s, self.holds, self.waiting = 0, -ONE_S, 0, False

    def stop(self, number: int, frame: FrameType | None) -> None:
        if time.monotonic() - self.last_s < ONE_S:
            return
        self.count, self.last_s = self.count + 1, time.monotonic()
        if self.count >= MOST:
            os._exit(INTERRUPTED)
        self.obey(number, frame)

    def obey(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt; again later where nobody may have heard it: what is raised in a
        destructor is lost."""
        self.waiting = bool(self.holds)
        if self.waiting:
            return
        called_back = _within(frame, "llvmlite", "_raw_object_cache")
        signal.setitimer(signal.ITIMER_VIRTUAL, AGAIN_S if called_back else UNHEARD_S)
        if called_back:
            return
        boxing = _within(frame, "numba", "_numba_unpickle")
        if boxing is not None and boxing.f_back is not None:
            _raise_in(boxing.f_back)
            return
        raise KeyboardInterrupt


def _within(frame: FrameType | None, package: str, name: str) -> FrameType | None:
    """The frame that compiled code called back, which does not survive an exception of it: LLVM
    calls ``_raw_object_cache…``, and numba, where a function hands back its result,
    ``_numba_unpickle``."""
    while frame is not None:
        code = frame.f_code
        if code.co_name.startswith(name) and package in code.co_filename:
            return frame
        frame = frame.f_back
    return None


def _raise_in(caller: FrameType) -> None:
    """Raise KeyboardInterrupt on the next line of ``caller``, back from compiled code."""

    def trace(frame: FrameType, event: str, argument: object) -> None:
        if frame is caller:
            sys.settrace(None)
            frame.f_trace = None
            raise KeyboardInterrupt

    caller.f_trace = trace
    sys.settrace(trace)


_signals = _Signals()


@contextmanager
def interruptible() -> Iterator[None]:
    """Signals end the block with a KeyboardInterrupt, but for those that are ignored (nohup)."""
    global _signals
    _keep_petsc_from_signals()
    outer, _signals = _signals, _Signals()
    actions: dict[signal.Signals, Callable[[int, FrameType | None], None]] = {
        number: _signals.stop
        for number in SIGNALS
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    actions[signal.SIGVTALRM] = _signals.obey
    if threading.current_thread() is not threading.main_thread():  # which alone hears signals
        actions = {}
    before = {number: signal.signal(number, action) for number, action in actions.items()}
    try:
        yield
    finally:
        heard()
        for number, handler in before.items():
            signal.signal(number, handler)
        _signals = outer


def _keep_petsc_from_signals() -> None:
    """Have PETSc, which starts later, answer no signal.

    It would answer SIGPIPE, which a rank gets that tells its last words after mpirun was killed, by
    aborting MPI, which then waits for ever for the lock that these words hold.
    """
    options = os.environ.get(PETSC_OPTIONS, "")
    if NO_HANDLER not in options.split():
        os.environ[PETSC_OPTIONS] = f"{options} {NO_HANDLER}".strip()


def heard() -> None:
    """Say that an interruption has reached whom it concerns, so that it is not repeated."""
    if threading.current_thread() is threading.main_thread():
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """An interruption waits for the end of the block, which is to be a matter of milliseconds."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _signals.holds += 1
    try:
        yield
    finally:
        _signals.holds -= 1
    if _signals.waiting:
        _signals.obey(0, None)


def leave(status: int) -> None:
    """End an interrupted process at once where a thread in compiled code would go on.

    A file that it writes into the cache is whole before.
    """
    if status == INTERRUPTED and threading.active_count() > 1:
        from ...solver.cache import WRITING

        sys.stdout.flush()
        sys.stderr.flush()
        WRITING.acquire()
        os._exit(status)
