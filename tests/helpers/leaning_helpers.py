"""What the tests of leaning drops share: a beam, a drop of it, and the reference's impact."""

from __future__ import annotations

import math

import leaning_reference as lr
import numpy as np

from bristle.solver.bodies.beam import beam_body
from bristle.solver.bristle import Bristle, Material
from bristle.solver.contact.enforcement import ContactMethod, Enforcement
from bristle.solver.contact.laws import Coulomb, Linear, mindlin_ratio
from bristle.solver.drop import DropPlan, ModalFrame, simulate
from bristle.solver.ground import Ground
from bristle.solver.rigid import leaning, matrix_of
from bristle.solver.time.flight import Flight
from bristle.solver.time.search import next_touch

G = 9.8
HEIGHT = 0.05
SPEED = math.sqrt(2.0 * G * HEIGHT)
KT = mindlin_ratio(0.28)


def beam(beta=1e-8, n=12, *, face=True, points=9, alpha=0.0, **shape) -> ModalFrame:
    """The paper's bristle as a beam, or another of ``shape`` (length_m, section)."""
    bristle = Bristle(material=Material(alpha_1_s=alpha, beta_s=beta), **shape)
    return ModalFrame(beam_body(bristle, n, face=face, points=points))


def plan(kn=2e6, its=1e-6, *, height=HEIGHT, gravity=G, mu=0.0, kt=KT, method=None, **where):
    """A drop onto a plane of ``kn`` and ``mu``, of the first impact alone unless told otherwise."""
    method = dict({"enforcement": Enforcement.PENALTY}, **(method or {}))
    contact = ContactMethod(Linear(kn), friction=Coulomb(mu, kt), **method)
    where.setdefault("impact_only", "until_s" not in where)
    return DropPlan(height, contact, its, gravity, **where)


def next_touch_of(flight: Flight, ground: Ground, until_s: float) -> float | None:
    """When a flight that starts at zero touches the ground, or None."""
    found = next_touch(flight.motion, ground.normals, ground.offsets_m, until_s)
    return None if math.isinf(found) else found


def drop(frame, kn=2e6, its=1e-6, **options):
    return simulate(frame, plan(kn, its, **options))


def kept(result, frame) -> float:
    """What the plane's impulse left of the speed of fall."""
    return result.impulse_N_s / (frame.modal.mass_kg * result.impact_speed_m_s) - 1.0


def series(lean, kn, beta, result, *, face, gravity=G, step_s=1e-7, **options) -> lr.LeaningImpact:
    """The reference's impact, looked at as long as ``result`` was in contact."""
    return lr.leaning_series(
        lean,
        kn,
        beta,
        face=face,
        speed=result.impact_speed_m_s,
        gravity=gravity,
        until_s=result.contact_time_s + 1e-5,
        step_s=step_s,
        **options,
    )


def tip_velocity(result, frame, tilt_deg) -> np.ndarray:
    """Of the rigid motion after the impact, at the middle of the end section, in the world."""
    arm = frame.modal.contact.weights @ frame.modal.contact.places_m
    turning = matrix_of(leaning(tilt_deg)) @ np.cross(result.spin_after_rad_s, arm)
    return np.array(result.velocity_after_m_s) + turning
