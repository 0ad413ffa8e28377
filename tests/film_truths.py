"""Films with known truth, tracked and compared with it: the table of docs/films.md.

    docker/run python3 tests/film_truths.py ../shared/data/films

The folder has ``truths.toml`` and, for each film, a table of its true tips. Each film is tracked in
a process of its own with one thread, whose CPU time and memory are those of the table.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import bristle

BLURRED_PX = 10.0
NORMAL_90 = 1.645
GRAVITY = 9.8
HEADS = {
    "film": "film",
    "frames": "frames",
    "sharp": "sharp",
    "blurred": "blurred",
    "offset": "mean",
    "share": "share",
    "own": "own",
    "kept": "kept, error/90 %",
    "lean": "lean",
    "impact": "impact ms",
    "gravity": "gravity",
    "cpu": "ms/frame",
    "memory": "MB",
}


def options(film: dict[str, Any]) -> dict[str, Any]:
    """What a user would tell of a film."""
    told: dict[str, Any] = {}
    if film["fps"] != film["fps_in_file"] or film["file"].endswith("/"):
        told["fps"] = film["fps"]
    if film["body"] == "ball":
        told |= {"body": "ball", "diameter_mm": film["diameter_mm"]}
    if "scale_in_view" not in film and film["body"] == "bristle":
        told["mm_per_px"] = film["mm_per_px"]
    if film["rolling_shutter_s_per_row"]:
        told["rolling_shutter_s_per_row"] = film["rolling_shutter_s_per_row"]
    return told


def compared(folder: Path, name: str, film: dict[str, Any]) -> dict[str, Any]:
    """What a film's track is worth."""
    begun = time.process_time()
    found = bristle.track(folder / film["file"], **options(film))
    cpu_s = time.process_time() - begun
    truth = pd.read_csv(folder / f"{name}.csv")
    both = found.table.merge(truth, on="frame", suffixes=("", "_true"))
    both = both[(both.crossed == 0) & (both.seen == 1)]
    error = (both.y_mm - both.y_mm_true).to_numpy()
    px = film["mm_per_px"]
    moves = np.abs(np.gradient(truth.y_px, truth.t_s))[both.frame] * film["exposure_s"]
    blurred = moves >= BLURRED_PX
    # what a film's frames err by in common is the zero's and the scale's
    height = both.y_mm.to_numpy()
    weight = 1.0 / both.sigma_frame_mm.to_numpy()
    design = np.stack([np.ones_like(height), height], axis=1) * weight[:, None]
    left = error * weight - design @ np.linalg.lstsq(design, error * weight, rcond=None)[0]
    drops = [(each, nearest(each, film["drops"])) for each in found.drops]
    kept = [
        (seen.estimate - true, 0.5 * (seen.high - seen.low))
        for one, other in drops
        for seen, true in zip(one.restitution[:1], other["restitution"], strict=False)
    ]
    worst = max(kept, key=lambda each: abs(each[0]))
    g = found.films[0].gravity_m_s2
    lean = both.lean_deg - both.lean_deg_true if "lean_deg_true" in both else None
    return {
        "film": name,
        "frames": len(both),
        "sharp": rms(error[~blurred]) / px,
        "blurred": rms(error[blurred]) / px,
        "offset": float(error.mean()) / px,
        "share": float(np.mean(np.abs(error) < NORMAL_90 * both.sigma_mm)),
        "own": float(np.mean(np.abs(left) < NORMAL_90)),
        "kept": f"{worst[0]:+.4f}/{worst[1]:.4f} in {sum(abs(e) < s for e, s in kept)}/{len(kept)}",
        "lean": float("nan") if lean is None else rms(lean.to_numpy()),
        "impact": 1e3 * max((a.impact_s[0] - b["impact_t_s"][0] for a, b in drops), key=abs),
        "gravity": float("nan") if g is None else g.estimate / GRAVITY - 1.0,
        "cpu": 1e3 * cpu_s / found.films[0].frames,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "drops": [len(found.drops), len(film["drops"])],
        "warnings": list(found.warnings),
    }


def nearest(seen: Any, true: list[dict[str, Any]]) -> dict[str, Any]:
    """The true drop whose first impact is nearest in time to that of the drop found."""
    return min(true, key=lambda each: abs(each["impact_t_s"][0] - seen.impact_s[0]))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def measured(folder: Path, name: str) -> dict[str, Any]:
    """The same in a process of its own."""
    command = [sys.executable, __file__, str(folder), "--only", name]
    one = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, env=one, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--films", nargs="*", help="names of films (default: all)")
    parser.add_argument("--only", help=argparse.SUPPRESS)
    given = parser.parse_args()
    films = tomllib.loads((given.folder / "truths.toml").read_text())
    if given.only:
        print(json.dumps(compared(given.folder, given.only, films[given.only])))
        return
    print("heights in px; share of frames within 1.645 sigma_mm, and of their own errors;")
    print("speed kept at the first impact: worst error, half its interval, how many are inside")
    print(" | ".join(HEADS.values()))
    for name in given.films or films:
        row = measured(given.folder, name)
        cells = [row[key] for key in HEADS]
        print(" | ".join(f"{c:.3g}" if isinstance(c, float) else str(c) for c in cells), flush=True)
        if row["drops"][0] != row["drops"][1]:
            print(f"  {row['drops'][0]} drops found, {row['drops'][1]} are true")
        for each in row["warnings"]:
            print(f"  {each}")


if __name__ == "__main__":
    main()
