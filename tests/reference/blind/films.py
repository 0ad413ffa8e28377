"""Films of drops: the height of the lower tip, frame by frame, through one bounce or two."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from .body import Array
from .drops import Truth, bounce, drag_1_m, rise, speed_down
from .upright import GRAVITY_M_S2

HELD, AT_RELEASE, MID_FALL = "held", "at release", "mid-fall"


def film(
    truth: Truth,
    height_m: float,
    order: int,
    luck: Array,
    fps: float,
    begins: str,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Times (frames,) of the camera's clock and true heights as they are read (frames,)."""
    down = speed_down(truth, height_m, truth.release_m_s)
    hit = fall_time(truth, height_m, truth.release_m_s)
    top, contact_s, _ = bounce(truth, down, order, luck)
    up = speed_up(truth, top)
    away = hit + contact_s
    turn, back = away + rise_time(truth, up), fall_time(truth, top, 0.0)
    again = turn + back
    second, second_s, _ = bounce(truth, speed_down(truth, top, 0.0), order, luck)
    away2 = again + second_s
    up2 = speed_up(truth, second)
    ends = again - rng.uniform(0.02, 0.3) * back
    if rng.random() < 0.4 and second > 2e-3:
        ends = away2 + rng.uniform(0.5, 1.3) * rise_time(truth, up2)
    starts = {
        HELD: -rng.uniform(0.1, 0.4),
        AT_RELEASE: 0.0,
        MID_FALL: rng.uniform(0.2, 0.6) * hit,
    }[begins]
    times = np.arange(starts + rng.uniform() / fps, ends, 1.0 / fps)
    y = np.zeros(len(times))
    for i, t in enumerate(times):
        if t < 0.0:
            y[i] = height_m
        elif t < hit:
            y[i] = height_m - fallen(truth, t, truth.release_m_s)
        elif t < away:
            y[i] = 0.0
        elif t < again:
            y[i] = flight(truth, t - away, up, top)
        elif t >= away2:
            y[i] = flight(truth, t - away2, up2, second)
    shown = (1.0 + truth.clock) * (times + rng.uniform(0.0, 2.0) - starts)
    return shown, (1.0 + truth.scale) * (y + truth.offset_m)


def speed_up(truth: Truth, top_m: float) -> float:
    """Speed upwards that carries to ``top_m``."""
    drag = drag_1_m(truth)
    if drag < 1e-12:
        return math.sqrt(2.0 * GRAVITY_M_S2 * top_m)
    return math.sqrt(GRAVITY_M_S2 / drag * math.expm1(2.0 * drag * top_m))


def rise_time(truth: Truth, speed_m_s: float) -> float:
    """Time to rest under gravity and drag."""
    drag = drag_1_m(truth)
    if drag < 1e-12:
        return speed_m_s / GRAVITY_M_S2
    root = math.sqrt(GRAVITY_M_S2 * drag)
    return math.atan(speed_m_s * root / GRAVITY_M_S2) / root


def fallen(truth: Truth, t_s: float, release_m_s: float) -> float:
    """Way down after ``t_s``, downwards positive."""
    if release_m_s < 0.0:
        turn = rise_time(truth, -release_m_s)
        if t_s < turn:
            return -flight(truth, t_s, -release_m_s, rise(truth, -release_m_s))
        return fallen(truth, t_s - turn, 0.0) - rise(truth, -release_m_s)
    drag = drag_1_m(truth)
    if drag < 1e-12:
        return release_m_s * t_s + 0.5 * GRAVITY_M_S2 * t_s**2
    last = math.sqrt(GRAVITY_M_S2 / drag)
    rate = math.sqrt(GRAVITY_M_S2 * drag)
    share = release_m_s / last
    return math.log(math.cosh(rate * t_s) + share * math.sinh(rate * t_s)) / drag


def fall_time(truth: Truth, height_m: float, release_m_s: float) -> float:
    """When the way down is ``height_m``, from the closed form."""
    longest = 1.0
    while fallen(truth, longest, release_m_s) < height_m:
        longest *= 2.0
    found = brentq(lambda t: fallen(truth, t, release_m_s) - height_m, 0.0, longest, xtol=1e-15)
    return float(found)


def flight(truth: Truth, t_s: float, speed_m_s: float, top_m: float) -> float:
    """Height ``t_s`` after the surface was left upwards with ``speed_m_s`` to reach ``top_m``."""
    turn = rise_time(truth, speed_m_s)
    if t_s >= turn:
        return top_m - fallen(truth, t_s - turn, 0.0)
    drag = drag_1_m(truth)
    if drag < 1e-12:
        return speed_m_s * t_s - 0.5 * GRAVITY_M_S2 * t_s**2
    root = math.sqrt(GRAVITY_M_S2 * drag)
    begin = math.atan(speed_m_s * root / GRAVITY_M_S2)
    return top_m + math.log(math.cos(begin - root * t_s)) / drag
