"""How a bristle stands over the ground as it touches, and its motion from there in its own axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .field_series import Array


@dataclass(frozen=True)
class Stand:
    """A rigid motion of the undeformed nodes into the world.

    A node at X is at ``turn`` (3, 3) times X - ``touching_m`` (3,): the world's origin is where the
    bristle first touches the ground.
    """

    turn: Array
    touching_m: Array

    @classmethod
    def of(cls, nodes_m: Array, displacement_m: Array) -> Stand:
        """The rigid motion nearest to a displacement (n, 3) of nodes (n, 3), in least squares
        (Kabsch, Acta Crystallographica A 32, 1976)."""
        middle, where = nodes_m.mean(axis=0), (nodes_m + displacement_m).mean(axis=0)
        left, _, right = np.linalg.svd((nodes_m - middle).T @ (nodes_m + displacement_m - where))
        # no mirror image, however thin the bristle
        proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
        turn = right.T @ proper @ left.T
        return cls(turn, middle - where @ turn)

    def moved(self, nodes_m: Array, displacement_m: Array) -> Array:
        """The displacement (n, 3) from that stand, along the bristle's axes there."""
        return (nodes_m + displacement_m) @ self.turn + self.touching_m - nodes_m

    def drawn(self, nodes_m: Array, moved_m: Array, factor: float, widening: Array) -> Array:
        """Places in the world, displacements from the stand ``factor`` times as large.

        ``widening`` (3,) makes the bristle larger along its own axes, about where it touches, so
        that it stays above the ground.
        """
        return ((nodes_m - self.touching_m) * widening + factor * moved_m) @ self.turn.T
