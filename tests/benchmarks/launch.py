"""What a command costs: its time, and the greatest memory of its own.

A script of its own that imports little: in a process's peak the kernel counts what its parent held
when it was made, so that a large parent would hide a small child.

    python3 -I launch.py COST.json COMMAND [ARGUMENT…]
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time


def main(cost: str, command: list[str]) -> int:
    """Run ``command`` and write wall_s, peak_rss_MB (10⁶ bytes) to ``cost``; its exit status."""
    started = time.perf_counter()
    child = os.posix_spawnp(command[0], command, os.environ)
    signal.signal(signal.SIGTERM, lambda *_: os.kill(child, signal.SIGTERM))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal sends it to the child too
    _, status, spent = os.wait4(child, 0)
    wall_s = time.perf_counter() - started
    with open(cost, "w", encoding="utf-8") as file:  # noqa: PTH123 - pathlib is much of a start
        json.dump({"wall_s": wall_s, "peak_rss_MB": spent.ru_maxrss * 1024 / 1e6}, file)
    return os.waitstatus_to_exitcode(status)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
