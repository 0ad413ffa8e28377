"""Writes down which lines of the program's functions run: Python imports it where it starts.

`plant_faults` has its folder on the path. Each line goes once for each test, named in the
environment, into a file that is named there too. What Numba has compiled runs unseen.
"""

import os
import sys
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType

LIVE = f"{Path(__file__).absolute().parents[3]}/docker/live/bristle/"
lines = os.open(os.environ["BRISTLE_LINES"], os.O_WRONLY | os.O_APPEND)
monitor = sys.monitoring


def executed(code: CodeType, line: int) -> object:
    """Note a line, but not of a module or a class, which runs where it is imported."""
    if code.co_flags & CO_OPTIMIZED and code.co_filename.startswith(LIVE):
        where = code.co_filename.removeprefix(LIVE)
        os.write(lines, f"{os.environ.get('BRISTLE_TEST', '')}\t{where}\t{line}\n".encode())
    return monitor.DISABLE


monitor.use_tool_id(monitor.COVERAGE_ID, "bristle")
monitor.register_callback(monitor.COVERAGE_ID, monitor.events.LINE, executed)
monitor.set_events(monitor.COVERAGE_ID, monitor.events.LINE)
