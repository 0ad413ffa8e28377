"""Which films would a camera make of bouncing bristles? By ballistics, apart from the loop's model.

y1 and the spin come from simulated drops of the beam, all else from parabolas written here.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bristle.solver.bristle import Bristle
from bristle.solver.contact.laws import Linear
from bristle.solver.effects.base import Scene
from bristle.solver.effects.library import EFFECTS, enter_all
from bristle.studies.loop.table_drops import beam_of, its_s, outcomes_of

GRAVITY = 9.81
HEIGHTS_M = (0.02, 0.03, 0.04, 0.05)
FRICTION = 0.5


def scenes(count, kn, effects, rng):
    """Scenes (count,) at heights in turn with effects {name: value}."""
    chosen = [EFFECTS[n](**{EFFECTS[n].parameters[0].name: v}) for n, v in effects.items()]
    plain = Scene(beta_s=Bristle().material.beta_s, law=Linear(kn))
    return [
        enter_all(
            replace(
                plain,
                height_m=HEIGHTS_M[i % len(HEIGHTS_M)] + rng.uniform(-2e-3, 2e-3),
                order=i,
                chance=tuple(rng.standard_normal(2)),
            ),
            chosen,
        )
        for i in range(count)
    ]


def bounce(scene):
    """Rise in a vacuum, contact time, and angular speed after the impact."""
    bristle = Bristle()
    fallen = scene.height_m + scene.release_speed_m_s**2 / (2 * GRAVITY)
    kn = scene.law.kn_N_m
    alike = [replace(scene, height_m=fallen)]
    found = outcomes_of(beam_of(bristle), alike, GRAVITY, its_s(bristle, kn), FRICTION)
    spin = math.hypot(float(found.spin_x_rad_s[0]), float(found.spin_y_rad_s[0]))
    return float(found.rebound_height_m[0]), float(found.contact_time_s[0]), spin


def film(scene, rng, fps=25.0, sigma_m=5e-4, seconds=0.7):
    """Times, heights as a camera's user reads them, and the truth (release in s, y1 in m)."""
    y1, touching, spin = bounce(scene)
    lighter = GRAVITY - 0.5 * Bristle().length_m * spin**2
    release = rng.uniform(0.1, 0.1 + 1 / fps)
    true_s = np.arange(0.0, seconds, 1 / fps)
    v0, height = scene.release_speed_m_s, scene.height_m
    landed = (math.sqrt(v0**2 + 2 * GRAVITY * height) - v0) / GRAVITY
    y = np.full(true_s.size, height)
    since = true_s - release
    falling = since > 0
    y[falling] -= v0 * since[falling] + GRAVITY * since[falling] ** 2 / 2
    begin, speed = landed + touching, math.sqrt(2 * lighter * y1)
    for _ in range(12):
        on = since > begin - touching
        y[on] = np.maximum(speed * (since - begin) - lighter * (since - begin) ** 2 / 2, 0.0)[on]
        begin += 2 * speed / lighter + touching
        speed *= math.sqrt(y1 / height)
    seen = scene.y_scale * (y + scene.y_offset_m) + sigma_m * rng.standard_normal(y.size)
    return scene.t_scale * true_s, seen, scene.t_scale * release, y1


def declare(folder, kind, keys):
    """A folder with the declarations of a dataset, whose table is named after its kind."""
    folder.mkdir(exist_ok=True)
    (folder / "dataset.toml").write_text(
        f'[dataset]\ntitle = "made"\nkind = "{kind}"\n[measurement]\nfile = "{kind}.csv"\n'
        f"gravity_m_s2 = {GRAVITY}\n{keys}"
    )


def write(folder, films, keys, numbers=None):
    """A dataset folder of kind tracks."""
    declare(folder, "tracks", keys)
    lines = ["drop,t_s,y_mm"]
    for n, (t, y, *_) in enumerate(films):
        number = n + 1 if numbers is None else numbers[n]
        lines += [f"{number},{a:.9g},{1e3 * b:.9g}" for a, b in zip(t, y, strict=True)]
    (folder / "tracks.csv").write_text("\n".join(lines) + "\n")
    return folder
