"""Drawing where there is no screen, in a process of its own.

Debian's VTK draws through X11 alone and takes the whole process down where it finds no X server.
So it draws in another one, on a display that xvfb-run provides for as long as the drawing lasts.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Sequence

ON_XVFB = ["xvfb-run", "-a", "-e", "/dev/stderr", "-s", "-screen 0 640x480x24"]
# With its caller, or when its time is over, the drawing ends, and its display with it.
BOUNDED = ["setpriv", "--pdeathsig", "TERM", "timeout", "--kill-after=5"]
TIMED_OUT = 124  # what timeout exits with


class DrawingError(RuntimeError):
    """A picture could not be drawn."""


def run_drawing(command: Sequence[str], timeout_s: float = 300.0) -> None:
    """Run a command that draws, on a display of its own or, without xvfb-run, on the caller's.

    Raises DrawingError, with the last that was written to standard error, where there is no
    display, or the command fails, dies or takes more than `timeout_s`.
    """
    on_display = ON_XVFB if shutil.which("xvfb-run") else []
    if not on_display and not os.environ.get("DISPLAY"):
        raise DrawingError("There is no display to draw on: install Xvfb or set DISPLAY.")
    with (
        tempfile.TemporaryFile("w+", errors="replace") as log,
        subprocess.Popen(
            [*BOUNDED, str(timeout_s), *on_display, *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
            text=True,
            errors="replace",
        ) as process,
    ):
        try:
            status = process.wait()
        finally:
            process.terminate()
        log.seek(0)
        output = log.read().strip().splitlines() or [f"exit status {status}"]
    if status == TIMED_OUT:
        raise DrawingError(f"Drawing took more than {timeout_s:g} s.")
    if status > 128 or status < 0:  # of a shell, or of the command itself
        name = signal.Signals(abs(status) % 128).name
        raise DrawingError(f"Drawing failed: {name}, {'; '.join(output[-2:])}")
    if status:
        raise DrawingError(f"Drawing failed: {output[-1]}")
