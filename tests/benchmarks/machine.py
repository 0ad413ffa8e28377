"""The machine that something was measured on, and processes started on it."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

LIBRARIES = ("fenics-dolfinx", "petsc4py", "numpy", "scipy", "numba")


def with_benchmarks(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment in which Python finds this package."""
    own = str(Path(__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, (own, environment.get("PYTHONPATH", ""))))
    return {**environment, "PYTHONPATH": path}


def facts() -> list[tuple[str, str]]:
    """Names and values for a page."""
    return [
        ("Processor", f"{_processor()}, {len(os.sched_getaffinity(0))} of {os.cpu_count()} cores"),
        ("Memory", f"{os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 1e9:.0f} GB"),
        ("Threads of a process", os.environ.get("OMP_NUM_THREADS", "not limited")),
        ("System", f"{_system()}, Python {platform.python_version()}"),
        ("Libraries", ", ".join(filter(None, (*map(_library, LIBRARIES), calculix_version())))),
    ]


def load() -> tuple[str, str]:
    """How busy the machine is, to be asked before something is timed."""
    return "Load as it began", f"{os.getloadavg()[0]:.1f} processes; it should be none"


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _system() -> str:
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except OSError:
        return platform.system()


def _library(name: str) -> str:
    try:
        return f"{name} {version(name)}"
    except PackageNotFoundError:
        return ""


def calculix_version() -> str:
    """Such as ``ccx 2.20``; empty where it is not installed."""
    program = shutil.which("ccx")
    if program is None:
        return ""
    told = subprocess.run([program, "-v"], capture_output=True, text=True, check=False).stdout
    return f"ccx {told.split()[-1]}" if told.split() else "ccx"
