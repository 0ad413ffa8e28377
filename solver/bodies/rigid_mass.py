"""A ball or any compact body in modes: one mass that moves up and down and touches at a point."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..bristle import RigidMass
from .base import ContactPoints
from .modal import ModalBody


def rigid_body(mass: RigidMass) -> ModalBody:
    """The mass as a body in modes: its only one is the vertical translation.

    It does not turn, slide or bend, and loses nothing by itself, so it serves for upright drops
    onto level ground: all that happens is the contact law's.
    """
    along: Array = np.array([[1.0 / math.sqrt(mass.mass_kg)]])
    point = ContactPoints(
        coordinates=along,
        support=np.zeros((1, 1), dtype=np.int64),
        shapes=np.array([[[0.0], [0.0], [1.0]]]),
        traction=np.zeros((3, 1)),
        weights=np.ones(1),
        places_m=np.zeros((1, 3)),
    )
    return ModalBody(
        name="rigid",
        omega2=np.zeros(1),
        translation=np.array([[0.0, 0.0, math.sqrt(mass.mass_kg)]]),
        rotation=np.zeros((1, 3)),
        contact=point,
        alpha_1_s=0.0,
        beta_s=0.0,
    )
