"""A page in a real browser, without a window and without a network.

Chromium is asked over a pipe in its DevTools protocol: JSON messages that end with a zero byte.
"""

from __future__ import annotations

import base64
import fcntl
import json
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
TIMEOUT_S = 60.0
# It may start as root and in a container; it may not ask anybody anything.
OPTIONS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"),
    *("--remote-debugging-pipe", "--no-first-run", "--disable-extensions", "--mute-audio"),
    *("--disable-background-networking", "--disable-sync", "--disable-component-update"),
    *("--host-resolver-rules=MAP * ~NOTFOUND", "--hide-scrollbars", "about:blank"),
)


class Browser:
    """One tab of a running browser."""

    def __init__(self, asks: int, answers: int) -> None:
        self._asks, self._answers = asks, answers
        self._number, self._left, self._session = 0, b"", ""
        self.events: list[dict[str, Any]] = []
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        attached = self.ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """What the browser answers; events that come meanwhile are kept."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._asks, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self.events.append(answer)

    def open(self, page: Path, width: int, height: int = 800) -> None:
        """Load a page in a window so many CSS pixels wide, and wait until it is laid out."""
        self.events.clear()
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        self.ask("Page.navigate", url=page.resolve().as_uri())
        while not any(event.get("method") == "Page.loadEventFired" for event in self.events):
            self.events.append(self._next())
        self.run("document.fonts.ready.then(() => true)")

    def run(self, expression: str) -> Any:
        """The value of an expression in the page; a promise is waited for."""
        answer = self.ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def complaints(self) -> list[str]:
        """Errors and warnings of the console since the page was opened, and failed requests."""
        said = []
        for event in self.events:
            about = event.get("params", {})
            match event.get("method"):
                case "Log.entryAdded" if about["entry"]["level"] in ("error", "warning"):
                    said.append(about["entry"]["text"])
                case "Runtime.consoleAPICalled" if about["type"] in ("error", "warning", "assert"):
                    said.append(str(about["args"]))
                case "Runtime.exceptionThrown" | "Network.loadingFailed":
                    said.append(str(about))
        return said

    def requests(self) -> list[str]:
        """Addresses that the page asked for."""
        asked = [e for e in self.events if e.get("method") == "Network.requestWillBeSent"]
        return [event["params"]["request"]["url"] for event in asked]

    def print(self) -> bytes:
        """The page on A4, as PDF."""
        sheet = {"paperWidth": 8.27, "paperHeight": 11.69, "preferCSSPageSize": True}
        return base64.b64decode(self.ask("Page.printToPDF", **sheet)["data"])

    def _next(self) -> dict[str, Any]:
        until = time.monotonic() + TIMEOUT_S
        while b"\0" not in self._left:
            ready, _, _ = select.select([self._answers], [], [], until - time.monotonic())
            assert ready, f"the browser said nothing for {TIMEOUT_S:g} s"
            some = os.read(self._answers, 1 << 20)
            assert some, "the browser has ended"
            self._left += some
        message, _, self._left = self._left.partition(b"\0")
        return json.loads(message)


@contextmanager
def browser() -> Iterator[Browser]:
    """A browser with a profile of its own, which ends with the block."""
    asks, answers = os.pipe(), os.pipe()
    ends = tuple(fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (asks[0], answers[1]))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # it reads at 3 and writes at 4; of shells, bash knows numbers of two digits
        wire = ["bash", "-c", f'exec "$@" 3<&{ends[0]} 4>&{ends[1]}', "bash"]
        process = subprocess.Popen(
            [*wire, str(CHROMIUM), f"--user-data-dir={profile}", *OPTIONS],
            pass_fds=ends,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        for end in (*ends, asks[0], answers[1]):
            os.close(end)
        try:
            yield Browser(asks[1], answers[0])
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            os.close(asks[1])
            os.close(answers[0])
