"""Films of random looks with a known truth, tracked and compared with it.

    docker/run python3 tests/film_campaign.py --first 5001 --films 40

tests/helpers/film_scenes.py draws each film from its seed. The first lines tell of each film: how
many frames the body is held and flies, the share of frames within 1.645 ``sigma_mm`` (of all, held,
flying), the error of heights in px (rms), the error of the zero in px and of the scale in
thousandths, each over its standard error, and that of the speed kept. The last lines tell of all.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from multiprocessing import Pool
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"
sys.path.insert(0, str(Path(__file__).parent / "helpers"))

import film_scenes  # noqa: E402
import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402

from bristle.solver.errors import InputError  # noqa: E402
from bristle.studies.inputs.study_fields import TrackInputs  # noqa: E402
from bristle.studies.track.films import summary, track_films  # noqa: E402

NORMAL_90 = 1.645
BLURRED_PX = 10.0
FEW_PER_S = 50.0


def compared(seed: int) -> dict[str, Any]:
    """What the track of a film is worth, in px."""
    scene = film_scenes.drawn_scene(seed)
    told = {"seed": seed, "scene": scene}
    with tempfile.TemporaryDirectory() as folder:
        file, truth = film_scenes.write_scene(Path(folder), scene)
        try:
            found = track_films([file], TrackInputs(**scene.options()))
        except InputError as error:
            return told | {"refused": str(error)}
    (film,) = found.films
    if film.scale is None:
        return told | {"refused": "no scale"}
    both = found.table.join(pd.DataFrame(truth).add_suffix("_true"), on="frame")
    both = both[~both.crossed_true]
    px = scene.mm_per_px
    error, sigma = (both.y_mm - both.y_mm_true) / px, both.sigma_mm / px
    flies = both.flight >= 0
    height = both.y_mm / px
    # what frames in flight err by in common is the zero's and the scale's
    zero = np.polyfit(height[flies], error[flies], 1)[1] if flies.sum() > 2 else 0.0
    shown = summary(found)["drops"]
    kept = shown[0]["restitution"][:1] if len(shown) == 1 else []
    return told | {
        "drops": len(shown),
        "error": error.to_numpy(),
        "inside": (error.abs() < NORMAL_90 * sigma).to_numpy(),
        "flies": flies.to_numpy(),
        "blurred": (both.blur_px_true > BLURRED_PX).to_numpy(),
        "zero": zero / (film.floor[1] or 1.0),
        "scale": (film.by / px - 1.0) / film.scale.error,
        "kept": [(k["estimate"] - scene.kept[0], 0.5 * (k["high"] - k["low"])) for k in kept],
        "lean": (both.lean_deg - both.lean_deg_true).to_numpy() if "lean_deg" in both else [],
    }


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def share(values: Any) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def line(row: dict[str, Any]) -> str:
    """What is told of one film."""
    s = row["scene"]
    look = f"{row['seed']:6d} {s.body:7s} {s.fps:4.0f}/s {s.encoding:5s} gamma {s.gamma:.1f}"
    if "refused" in row:
        return f"{look} refused: {row['refused']}"
    inside, flies, blurred = row["inside"], row["flies"], row["blurred"]
    shares = (f"{share(each):.2f}" for each in (inside, inside[~flies], inside[flies]))
    errors = (f"{rms(row['error'][each]):.2f}" for each in (~blurred, blurred))
    kept = " ".join(f"{e:+.4f}/{half:.4f}" for e, half in row["kept"])
    return (
        f"{look} | {(~flies).sum()} + {flies.sum()} | {' '.join(shares)} | {' '.join(errors)} px | "
        f"zero {row['zero']:+.1f} scale {row['scale']:+.1f} | kept {kept} | "
        f"lean {rms(row['lean']):.3f}"
    )


def told(name: str, rows: list[dict[str, Any]]) -> None:
    """What all films of a kind have in common."""
    if not rows:
        return
    inside, flies = (np.concatenate([row[key] for row in rows]) for key in ("inside", "flies"))
    of_film = np.array([share(row["inside"]) for row in rows])
    kept = np.array([each for row in rows for each in row["kept"]]).reshape(-1, 2)
    sharp = np.array([rms(row["error"][~row["blurred"]]) for row in rows])
    blurred = np.array([rms(r["error"][r["blurred"]]) for r in rows if r["blurred"].any()])
    leans = np.array([rms(row["lean"]) for row in rows if len(row["lean"])])
    print(f"{name}: {len(rows)} films")
    print(
        f"  within 1.645 sigma_mm: frames {share(inside):.3f}, held {share(inside[~flies]):.3f}, "
        f"flying {share(inside[flies]):.3f}; mean of films {of_film.mean():.3f}, "
        f"tenths {np.round(np.percentile(of_film, [10, 25, 50, 75, 90]), 2)}, "
        f"88 to 92 % in {share((of_film > 0.875) & (of_film < 0.925)):.2f} of them"
    )
    print(
        f"  rms over standard error: zero {rms([row['zero'] for row in rows]):.2f}, "
        f"scale {rms([row['scale'] for row in rows]):.2f}"
    )
    print(
        f"  sharp ends within 0.15 px in {share(sharp < 0.15):.2f} (median {np.median(sharp):.2f})"
        f", blurred within 0.5 px in {share(blurred < 0.5):.2f} of {len(blurred)}, "
        f"lean within 0.1 degrees in {share(leans < 0.1):.2f}"
    )
    error = np.abs(kept[:, 0])
    print(
        f"  speed kept: within 0.005 in {share(error < 0.005):.2f}, "
        f"inside its 90 % interval in {share(error < kept[:, 1]):.2f} of {len(kept)}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=1, help="seed of the first film")
    parser.add_argument("--films", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    rows = []
    with Pool(given.jobs) as pool:
        for row in pool.imap(compared, range(given.first, given.first + given.films)):
            print(line(row), flush=True)
            rows.append(row)
    good = [row for row in rows if "refused" not in row]
    print(f"{len(rows) - len(good)} refused; {sum(r['drops'] != 1 for r in good)} with other drops")
    ball = [row for row in good if row["scene"].body == "ball"]
    other = [row for row in good if row["scene"].body != "ball"]
    told("bristles, 60 frames/s or more", [r for r in other if r["scene"].fps > FEW_PER_S])
    told("bristles, 25 or 30 frames/s", [r for r in other if r["scene"].fps < FEW_PER_S])
    told("balls", ball)
    told("all", good)


if __name__ == "__main__":
    main()
