"""Records of a load cell that bristles bounce on: the beam's drops, sampled."""

from __future__ import annotations

from dataclasses import replace

import film_data
import numpy as np

from bristle.solver.bristle import Bristle
from bristle.studies.loop.responses.force_curves import force_history

ITS_S = 2.5e-7
Y_SIGMA_MM = 0.1


def record(scene, rng, step_s=2e-6, sigma_N=0.5, seconds=5e-4):
    """Times, forces, and the true time of the touch, on a clock that a trigger started."""
    fallen = scene.height_m + scene.release_speed_m_s**2 / (2 * film_data.GRAVITY)
    t, impulse = force_history(
        Bristle(),
        replace(scene, height_m=fallen),
        film_data.GRAVITY,
        film_data.FRICTION,
        ITS_S,
        1e-3,
    )
    touch = rng.uniform(2e-5, 6e-5)
    samples = np.arange(0.0, seconds, step_s)
    since = samples / scene.t_scale - touch
    # the mean over a step of the march is the force at its middle
    half = 0.5 * ITS_S
    force = np.interp(since + half, t, impulse, left=0.0) - np.interp(
        since - half, t, impulse, left=0.0
    )
    force = force / (2 * half) + sigma_N * rng.standard_normal(samples.size)
    return samples, force, touch * scene.t_scale


def seen_height(scene, rng):
    """What a ruler says of y0, in m."""
    true = scene.y_scale * (scene.height_m + scene.y_offset_m)
    return true + 1e-3 * Y_SIGMA_MM * rng.standard_normal()


def write(folder, records, heights_m, keys, y1_m=None):
    """A dataset folder of kind forces."""
    film_data.declare(folder, "forces", f"sigma_y_mm = {Y_SIGMA_MM}\n{keys}")
    lines = ["drop,t_s,force_N"]
    for n, (t, force, *_) in enumerate(records):
        lines += [f"{n + 1},{a:.9g},{b:.6g}" for a, b in zip(t, force, strict=True)]
    (folder / "forces.csv").write_text("\n".join(lines) + "\n")
    head = "drop,y0_mm" if y1_m is None else "drop,y0_mm,y1_mm"
    after = [""] * len(heights_m) if y1_m is None else [f",{1e3 * y:.6g}" for y in y1_m]
    drops = [f"{n + 1},{1e3 * y:.6g}{after[n]}" for n, y in enumerate(heights_m)]
    (folder / "drops.csv").write_text("\n".join([head, *drops]) + "\n")
    return folder
