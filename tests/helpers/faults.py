"""Commands killed on their way, and what they left behind."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

from commands import environment

from bristle.studies.running.mark import MARK, UNFINISHED

# What differs from run to run: times, memory, and how many cases were left to do.
TIMES = ("wall_s", "peak_rss_MB", "drops_per_second", "ranks")
# A drop that is marched step by step, with a mark at each look at the clock.
FULL_SOLID = ("drop", "--model", "solid", "--cells", "1", "1", "40", "--keep", "0")
SAID = re.compile(r"<dt>Wall time</dt>\s*<dd>.*?</dd>", re.S)


def started(arguments, ranks=1, **more):
    """A command in a process, or under mpirun, whose standard error can be read."""
    command = [sys.executable, "-m", "bristle.studies.cli", *map(str, arguments)]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), "--oversubscribe", *command]
    more = {"stdout": subprocess.PIPE, **more}
    ends = {"stdin": subprocess.DEVNULL, "stderr": subprocess.PIPE, **more}
    return subprocess.Popen(command, text=True, env=environment(), **ends)


def ended(process, timeout_s=120.0):
    """Status, standard output and lines of standard error of a process that has to end in time."""
    try:
        out, err = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return process.returncode, out, err.splitlines()


def wait_for(there, process, patience_s=120.0):
    """Wait until ``there()`` is true, or the process has ended."""
    until = time.monotonic() + patience_s
    while not there() and process.poll() is None and time.monotonic() < until:
        time.sleep(0.002)


def ranks_of(process):
    """The process ids of the ranks that an mpirun has started."""
    found = []
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            text = status.read_text()
            name = (status.parent / "cmdline").read_bytes().split(b"\0")[0]
        except OSError:
            continue
        parent = re.search(r"^PPid:\s*(\d+)", text, re.M)
        if parent and int(parent[1]) == process.pid and name.endswith(b"python3"):
            found.append(int(status.parent.name))
    return sorted(found)


def left_running(pids, patience_s=60.0):
    """Which of these processes have not ended after so long."""
    until = time.monotonic() + patience_s
    while (left := [pid for pid in pids if _running(pid)]) and time.monotonic() < until:
        time.sleep(0.1)
    return left


def _running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def journal_lines(out):
    """How many finished cases a study has noted so far."""
    path = Path(out) / "cases.jsonl"
    return max(path.read_bytes().count(b"\n") - 1, 0) if path.exists() else 0


def hidden(folder):
    """What was left unfinished anywhere in a folder."""
    return sorted(
        str(path)
        for path in Path(folder).rglob("*")
        if path.name.startswith((".", UNFINISHED)) or path.suffix == ".part"
    )


# ADIOS2's own files that hold when a frame was written.
WRITTEN_WHEN = ("md.idx", "profiling.json")


def told(out):
    """Everything that a result holds, file by file, but times, memory and their digests."""
    return {
        str(path.relative_to(out)): _content(path)
        for path in sorted(Path(out).rglob("*"))
        if path.is_file() and path.suffix != ".png" and path.name not in (MARK, *WRITTEN_WHEN)
    }


def _content(path):
    if path.name == "cases.jsonl":  # in the order in which they were done
        lines = map(json.loads, path.read_text().splitlines())
        return sorted(json.dumps(_plain(line)) for line in lines)
    if path.suffix == ".json":
        return _plain(json.loads(path.read_text()))
    if path.suffix == ".csv":
        head, *rows = path.read_text().splitlines()
        names = head.split(",")
        keep = [i for i, name in enumerate(names) if name not in TIMES]
        return [[row.split(",")[i] for i in keep] for row in rows] if "wall_s" in names else rows
    if path.suffix == ".html":
        return SAID.sub("", path.read_text())
    return path.read_bytes()


def _plain(value):
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if k not in (*TIMES, "sha256")}
    return [_plain(each) for each in value] if isinstance(value, list) else value


def send(process, number, whom="all"):
    """Signal a process or, of an mpirun, its last rank alone."""
    if whom == "rank":
        os.kill(ranks_of(process)[-1], number)
    else:
        process.send_signal(signal.Signals(number))
