"""How often is the loop right on toy problems of known truth? Prints a table.

docker/run python3 tests/loop_rates.py [DATASETS [ROW…]]
"""

from __future__ import annotations

import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

# One thread each: the work is shared out by dataset.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import loop_toys as toys
import numpy as np

from bristle.studies.loop.finding import Finding
from bristle.studies.loop.problem import Problem
from bristle.studies.loop.run import find

DISTINCT = ("offset", "drag", "stiffening", "plastic", "adhesion", "wear", "dashpot", "release")
ROWS: dict[str, dict[str, Any]] = {
    "clean": {},
    "clean, 3 quantities": {"quantities": 3},
    "clean, 1 quantity": {"quantities": 1},
    "clean, ar1": {"how": "ar1"},
    "clean, t3 scaled": {"how": "t3 scaled"},
    "clean, outliers": {"how": "outliers"},
    "clean, sigma free": {"declared": False},
    "single d=8": {"d": 8.0},
    "single d=8, 3 quantities": {"d": 8.0, "quantities": 3},
    "single d=12": {"d": 12.0},
    "scatter d=8": {"d": 8.0, "of": tuple(toys.SCALED)},
    "single d=8, ar1": {"d": 8.0, "how": "ar1"},
    "single d=8, t3 scaled": {"d": 8.0, "how": "t3 scaled"},
    "single d=8, sigma free": {"d": 8.0, "declared": False},
    "scatter of 1.6 sigma": {"how": "double"},
    "unlisted d=8": {"unlisted": 8.0},
    "unlisted d=16": {"unlisted": 16.0},
    "pair d=8 + 8": {"d": 8.0, "two": True},
    "pair d=11 + 11": {"d": 11.0, "two": True},
}


def one(task: tuple[str, int]) -> tuple[str, dict[str, float]]:
    """What happened, in words, and the scores of one dataset of a row."""
    row, seed = task
    options = dict(ROWS[row])
    rng = np.random.default_rng([11, seed])
    truth: dict[str, float] = {}
    if "d" in options:
        of = options.pop("of", DISTINCT)
        count = 2 if options.pop("two", False) else 1
        chosen = rng.choice(len(of), size=count, replace=False)
        size = options.pop("d")
        truth = {of[i]: size for i in chosen}
    if "unlisted" in options:
        options["unlisted"] = (list(toys.UNLISTED)[seed % len(toys.UNLISTED)], options["unlisted"])
    made, amounts = toys.problem(seed, truth, **options)
    begin = time.perf_counter()
    found = find(made, seed=seed)
    out = {"seconds": time.perf_counter() - begin, str(found.verdict): 1.0}
    if truth:
        out |= _score(made, amounts, truth, found)
    words = (
        f"{row} {seed} {truth or options.get('unlisted', '')} -> {found.verdict} {found.effects} "
        f"p {found.p_value:.3f} left {found.open_set_p_value:.3f} {found.statistic} {found.noise}"
    )
    return words, out


def _score(
    made: Problem, amounts: dict[str, float], truth: dict[str, float], found: Finding
) -> dict[str, float]:
    named = set(found.effects)
    near = [{n} | set(next((c for c in found.classes if n in c), ())) for n in truth]
    out = {
        "names": float(len(named)) if named else np.nan,
        "in set": float(set(truth) <= named),
        "classes in set": float(all(c & named for c in near)),
        "first": float(bool(found.effects) and found.effects[0] in set().union(*near)),
        "single when two": float(len(truth) == 2 and len(found.model_effects) == 1),
    }
    if set(found.model_effects) == set(truth):
        intervals = [found.parameters[name] for name in ("kn", *truth)]
        inside = [
            x.low <= amounts[n] <= x.high for x, n in zip(intervals, ("kn", *truth), strict=True)
        ]
        out["intervals cover"] = float(np.mean(inside))
    held = found.held_out
    if held is not None:
        out["held-out cover"] = held.coverage_90
        oracle = float(
            np.sqrt(np.mean(((made.values - made.notes["mean"]) * made.scale)[held.rows] ** 2))
        )
        if held.rms_before > 1.02 * oracle:
            out["recovered"] = (held.rms_before - held.rms_after) / (held.rms_before - oracle)
    return out


def table(count: int, rows: list[str], log: str | None = None) -> dict[str, dict[str, float]]:
    """Mean scores by row (median for what was recovered), printed as they come."""
    out: dict[str, dict[str, float]] = {}
    with ProcessPoolExecutor(2) as pool:
        for row in rows:
            many = list(pool.map(one, [(row, seed) for seed in range(count)], chunksize=3))
            if log:
                with Path(log).open("a") as file:
                    file.writelines(words + "\n" for words, _ in many)
            out[row] = _summary([scores for _, scores in many])
            cells = "  ".join(f"{key} {value:.3f}" for key, value in out[row].items())
            print(f"{row:25s} n={count}  {cells}", flush=True)
    return out


def _summary(many: list[dict[str, float]]) -> dict[str, float]:
    verdicts = ("adequate", "effect", "ambiguous", "unknown")
    keys = dict.fromkeys(key for each in many for key in each)
    out = {}
    for key in keys:
        values = np.array([m.get(key, 0.0 if key in verdicts else np.nan) for m in many])
        out[key] = float(np.nanmedian(values) if key == "recovered" else np.nanmean(values))
    out["slowest"] = max(each["seconds"] for each in many)
    return out


if __name__ == "__main__":
    asked = sys.argv[2:]
    table(
        int(sys.argv[1]) if len(sys.argv) > 1 else 100,
        [row for row in ROWS if not asked or any(row.startswith(a) for a in asked)],
        os.environ.get("RATES_LOG"),
    )
