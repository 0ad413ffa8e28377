"""How does the bristle stand as it touches, and how does it move from there in its own axes?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .field_series import Array


@dataclass(frozen=True)
class Stand:
    """The rigid motion that puts the undeformed nodes where they are at the touch.

    ``turn`` (3, 3), ``shift_m`` (3,): a node at X is at turn X + shift.
    """

    turn: Array
    shift_m: Array

    @classmethod
    def of(cls, nodes_m: Array, displacement_m: Array) -> Stand:
        """The rigid motion nearest to a displacement (n, 3) of nodes (n, 3), in least squares
        (Kabsch, Acta Crystallographica A 32, 1976)."""
        middle, where = nodes_m.mean(axis=0), (nodes_m + displacement_m).mean(axis=0)
        left, _, right = np.linalg.svd((nodes_m - middle).T @ (nodes_m + displacement_m - where))
        # no mirror image, however thin the bristle
        proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
        turn = right.T @ proper @ left.T
        return cls(turn, where - turn @ middle)

    def moved(self, nodes_m: Array, displacement_m: Array) -> Array:
        """The displacement (n, 3) from that stand, along the bristle's axes there."""
        return (nodes_m + displacement_m - self.shift_m) @ self.turn - nodes_m

    @property
    def lean_deg(self) -> float:
        """Angle between the bristle's axis and the vertical."""
        return float(np.degrees(np.arccos(np.clip(self.turn[2, 2], -1.0, 1.0))))

    def plane_m(self, side: int, lateral_m: Array) -> Array:
        """Height of the ground along the bristle's axis at places along a lateral axis."""
        normal = self.turn[2]
        below = -self.shift_m @ self.turn @ normal
        return (below - normal[side] * lateral_m) / normal[2]
