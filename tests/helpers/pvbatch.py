"""Programs run in ParaView, on a display of their own."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

needs_pvbatch = pytest.mark.skipif(
    shutil.which("pvbatch") is None or shutil.which("xvfb-run") is None,
    reason="ParaView's pvbatch or xvfb-run is not installed",
)
TIMEOUT_S = 120.0


def run_pvbatch(program: Path, *arguments: object) -> str:
    """Run it, require success, return its standard output; ends display and all with a timeout."""
    command = ["xvfb-run", "-a", "pvbatch", str(program), *map(str, arguments)]
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        said, complained = process.communicate(timeout=TIMEOUT_S)
    except BaseException:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise
    assert process.returncode == 0, complained[-3000:]
    return said
