"""A display for VTK where there is no screen.

Debian's VTK draws through X11 alone and takes the whole process down where it finds no X server.
So it draws in a process of its own, on an Xvfb that lives as long as the drawing.
"""

from __future__ import annotations

import os
import select
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO

START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 5.0


class DrawingError(RuntimeError):
    """A picture could not be drawn."""


@contextmanager
def display_environment() -> Iterator[dict[str, str]]:
    """Provide the environment variables of a process that is to draw.

    A private Xvfb is started where one is installed, else the caller's own DISPLAY is taken.  The
    server ends with the block, with its last client, or with this process, whichever is first.

    Raises
    ------
    DrawingError : neither is there, or Xvfb does not start
    """
    xvfb = shutil.which("Xvfb")
    if xvfb is None:
        if not os.environ.get("DISPLAY"):
            raise DrawingError("There is no display to draw on: install Xvfb or set DISPLAY.")
        yield dict(os.environ)
        return
    with tempfile.TemporaryFile() as log:
        server, display = _start(xvfb, log)
        try:
            yield {**os.environ, "DISPLAY": display}
        finally:
            _stop(server)


def run_drawing(
    command: Sequence[str], timeout_s: float = 300.0, advance: Callable[[], None] = lambda: None
) -> None:
    """Run a command that draws, on a display of its own.

    ``advance`` is called for each line that it writes to standard output.

    Raises
    ------
    DrawingError : there is no display, or the command fails, dies or takes more than `timeout_s`;
        with the last line that it wrote to standard error
    """
    with (
        display_environment() as environment,
        tempfile.TemporaryFile("w+", errors="replace") as log,
        subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            errors="replace",
        ) as process,
    ):
        late = threading.Timer(timeout_s, process.kill)
        late.start()
        try:
            for _ in process.stdout or ():
                advance()
            status = process.wait()
            in_time = late.is_alive()
        finally:
            late.cancel()
            process.kill()
        log.seek(0)
        output = log.read().strip().splitlines() or [f"exit status {status}"]
    if not in_time:
        raise DrawingError(f"Drawing took more than {timeout_s:g} s.")
    if status != 0:
        died = f"{signal.Signals(-status).name}, " if status < 0 else ""
        raise DrawingError(f"Drawing failed: {died}{output[-1]}")


def _start(xvfb: str, log: IO[bytes]) -> tuple[subprocess.Popen, str]:
    """Start Xvfb on a display number that it finds free itself, and wait until it is ready."""
    setpriv = shutil.which("setpriv")
    # Without this, a killed caller would leave a server behind that no client ever used.
    with_parent = [setpriv, "--pdeathsig", "TERM"] if setpriv else []
    command = [*with_parent, xvfb, "-terminate", "-nolisten", "tcp", "-screen", "0", "640x480x24"]
    ready, write_end = os.pipe()
    try:
        try:
            server = subprocess.Popen(
                [*command, "-displayfd", str(write_end)],
                pass_fds=(write_end,),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        finally:
            os.close(write_end)
        try:
            return server, f":{_read_number(ready)}"
        except BaseException:
            _stop(server)
            raise
    except (DrawingError, OSError) as error:
        log.seek(0)
        output = log.read().decode(errors="replace").strip().splitlines() or [str(error)]
        raise DrawingError(f"Xvfb did not start: {output[-1]}") from error
    finally:
        os.close(ready)


def _read_number(ready: int) -> str:
    received = b""
    while not received.endswith(b"\n"):
        readable, _, _ = select.select([ready], [], [], START_TIMEOUT_S)
        chunk = os.read(ready, 64) if readable else b""
        if not chunk:
            raise DrawingError("no display number")
        received += chunk
    return received.decode().strip()


def _stop(server: subprocess.Popen) -> None:
    server.terminate()
    try:
        server.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        server.kill()
        server.wait()
