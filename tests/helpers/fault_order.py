"""A pytest plugin for `plant_faults`: what tests execute, and their order where a fault is."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest


def _now(test: str) -> None:
    """What runs from here on counts for this test, or for all tests of a file."""
    os.environ["BRISTLE_TEST"] = test
    sys.monitoring.restart_events()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Any:
    _now(item.nodeid)
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Any:
    if fixturedef.scope == "function":
        return (yield)
    test = os.environ["BRISTLE_TEST"]
    _now(test.partition("::")[0])
    try:
        return (yield)
    finally:
        _now(test)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if "BRISTLE_REPORTS" in os.environ:
        with Path(os.environ["BRISTLE_REPORTS"]).open("a") as file:
            file.write(f"{report.nodeid}\t{report.duration}\t{report.outcome}\n")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that execute the fault first; none may take far longer than without it."""
    if "BRISTLE_ORDER" in os.environ:
        order = json.loads(Path(os.environ["BRISTLE_ORDER"]).read_text())
        first = set(order["first"])
        items.sort(key=lambda item: item.nodeid not in first)
        for item in items:
            if item.nodeid in order["limit_s"]:  # campaigns are left out later
                item.add_marker(pytest.mark.timeout(order["limit_s"][item.nodeid]))
