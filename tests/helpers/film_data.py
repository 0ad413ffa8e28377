"""Films that a camera would make of bouncing bodies, by ballistics apart from the loop's model.

y1 and the spin come from simulated drops of the beam, all else from motion integrated here.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

from bristle.solver.bristle import Bristle
from bristle.solver.contact.laws import Linear
from bristle.solver.effects.base import Scene
from bristle.solver.effects.library import EFFECTS, enter_all
from bristle.studies.loop.responses.table_drops import beam_of, its_s, outcomes_of

GRAVITY = 9.81
HEIGHTS_M = (0.02, 0.03, 0.04, 0.05)
FRICTION = 0.5


def scenes(count, kn, effects, rng, heights_m=HEIGHTS_M):
    """Scenes (count,) at heights in turn with effects {name: value}."""
    chosen = [EFFECTS[n](**{EFFECTS[n].parameters[0].name: v}) for n, v in effects.items()]
    plain = Scene(beta_s=Bristle().material.beta_s, law=Linear(kn))
    return [
        enter_all(
            replace(
                plain,
                height_m=heights_m[i % len(heights_m)] + rng.uniform(-2e-3, 2e-3),
                order=i,
                chance=tuple(rng.standard_normal(2)),
            ),
            chosen,
        )
        for i in range(count)
    ]


def bounce(scene, fallen_m):
    """Rise in a vacuum, contact time, and angular speed after an impact as from ``fallen_m``."""
    bristle = Bristle()
    kn = scene.law.kn_N_m
    alike = [replace(scene, height_m=fallen_m)]
    found = outcomes_of(beam_of(bristle), alike, GRAVITY, its_s(bristle, kn), FRICTION)
    spin = math.hypot(float(found.spin_x_rad_s[0]), float(found.spin_y_rad_s[0]))
    return float(found.rebound_height_m[0]), float(found.contact_time_s[0]), spin


def path(t_s, height_m, rises, *, release_s=0.0, speed_m_s=0.0, drag_1_m=0.0):
    """Heights at the times ``t_s`` of a body let go at ``release_s`` with a speed downward.

    ``rises`` says of each bounce the square of the speed after it over that before, the gravity
    after it, and how long it touches, in which it stays at zero; after the last it is at zero.
    The motion under gravity and quadratic drag is integrated, by a general method.
    """
    y, speed = np.where(t_s < release_s, height_m, 0.0), -speed_m_s
    begin, level, gravity = release_s, height_m, GRAVITY
    for ratio, after, touching in (*rises, (0.0, GRAVITY, 0.0)):

        def moves(_, state, gravity=gravity):
            return [state[1], -gravity - drag_1_m * state[1] * abs(state[1])]

        def lands(_, state):
            return state[0]

        lands.terminal, lands.direction = True, -1
        span = (begin, begin + 10.0)
        found = solve_ivp(moves, span, [level, speed], "DOP853", None, True, lands, rtol=1e-10)
        end = float(found.t[-1])
        on = (t_s >= begin) & (t_s < end)
        if on.any():
            y[on] = found.sol(t_s[on])[0]
        begin, level = end + touching, 1e-12
        speed, gravity = -math.sqrt(ratio) * float(found.y[1, -1]), after
        if ratio <= 1e-4:
            break
    return y


def film(scene, rng, fps=25.0, sigma_m=5e-4, seconds=0.7, begins="held"):
    """Times, heights as a camera's user reads them, and the truth (release in s, y1 in m).

    A film ``begins`` while the bristle is held, or in mid-fall: a third of the fall's time late.
    """
    drag = scene.drag_kg_m / Bristle().mass_kg
    fallen = scene.height_m + scene.release_speed_m_s**2 / (2 * GRAVITY)
    if drag:
        fallen = -math.expm1(-2 * drag * fallen) / (2 * drag)
    y1, touching, spin = bounce(scene, fallen)
    lighter = GRAVITY - 0.5 * Bristle().length_m * spin**2
    late = -math.sqrt(2 * scene.height_m / GRAVITY) / 3
    release = rng.uniform(0.1, 0.1 + 1 / fps) if begins == "held" else late
    true_s = np.arange(0.0, seconds, 1 / fps)
    rises = [(y1 * lighter / (fallen * GRAVITY), lighter, touching)]
    rises += 6 * [(y1 / fallen, lighter, touching)]
    y = path(
        true_s,
        scene.height_m,
        rises,
        release_s=release,
        speed_m_s=scene.release_speed_m_s,
        drag_1_m=drag,
    )
    seen = scene.y_scale * (y + scene.y_offset_m) + sigma_m * rng.standard_normal(y.size)
    return scene.t_scale * true_s, seen, scene.t_scale * release, y1


def declare(folder, kind, keys):
    """A folder with the declarations of a dataset, whose table is named after its kind."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "dataset.toml").write_text(
        f'[dataset]\ntitle = "made"\nkind = "{kind}"\n[measurement]\nfile = "{kind}.csv"\n'
        f"gravity_m_s2 = {GRAVITY}\n{keys}"
    )


def write(folder, films, keys, numbers=None, px_per_m=None):
    """A dataset folder of kind tracks, in mm or, with so many of them to a metre, in pixels."""
    declare(folder, "tracks", keys)
    lines = ["drop,t_s,y_mm" if px_per_m is None else "drop,t_s,y_px"]
    unit = 1e3 if px_per_m is None else px_per_m
    for n, (t, y, *_) in enumerate(films):
        number = n + 1 if numbers is None else numbers[n]
        lines += [f"{number},{a:.9g},{unit * b:.9g}" for a, b in zip(t, y, strict=True)]
    (folder / "tracks.csv").write_text("\n".join(lines) + "\n")
    return folder
