"""Displacement, velocity and stress of a solid in contact as functions of dolfinx.

recorder = FieldRecorder(solid, marcher)
simulate(frame, plan, marcher, observer=recorder)
fields = recorder.fields()
fields.times_s, fields.displacement[-1], fields.stress[-1]
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import overload

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh, MeshTags

from .arrays import Array
from .bodies.solid import SolidBody
from .checkpoint import Mark
from .forms import own_values
from .ground import Placement
from .nodal_stress import VOIGT, NodalStress
from .rigid import Pose
from .time.finite import FiniteMarcher
from .time.march import ContactMarch, Moving

MOST_FRAMES = 400
# Index in Voigt's order of each component of a symmetric tensor (3, 3).
TENSOR = [
    next(k for k, pair in enumerate(VOIGT) if set(pair) == {i, j})
    for i in range(3)
    for j in range(3)
]


def carried(solid: SolidBody, u: Array, pose: Pose, origin_m: Array) -> Array:
    """Displacement (3 n,) in m from the upright mesh to the body's deformed position in the world.

    ``u`` is the displacement relative to the ``pose``; the world's origin is at ``origin_m`` (3,).
    """
    nodes = solid.places_m
    arm = nodes - solid.centre_m + u.reshape(-1, 3)
    place = arm @ pose.rotation.T + (pose.position_m - origin_m)
    return np.asarray(place - nodes).ravel()


def turned(vectors: Array, pose: Pose) -> Array:
    """Vectors (3 n,) rotated from the body's axes to those of the world."""
    return np.asarray(vectors.reshape(-1, 3) @ pose.rotation.T).ravel()


@dataclass(frozen=True)
class Series:
    """A field over time: ``series[i]`` is a new Function for the i-th instant. Collective."""

    times_s: Array
    make: Callable[[int], fem.Function]

    def __len__(self) -> int:
        return len(self.times_s)

    @overload
    def __getitem__(self, i: int) -> fem.Function: ...

    @overload
    def __getitem__(self, i: slice) -> list[fem.Function]: ...

    def __getitem__(self, i: int | slice) -> fem.Function | list[fem.Function]:
        chosen = range(len(self))[i]
        return self.make(chosen) if isinstance(chosen, int) else list(map(self.make, chosen))

    def __iter__(self) -> Iterator[fem.Function]:
        return map(self.make, range(len(self)))

    def at(self, t_s: float) -> fem.Function:
        """The field at the instant nearest to ``t_s``, in s since release."""
        return self[int(np.abs(self.times_s - t_s).argmin())]

    def __repr__(self) -> str:
        if not len(self):
            return "no instants"
        first, last = self.times_s[[0, -1]]
        return f"{len(self)} instants from {1e3 * first:.6g} to {1e3 * last:.6g} ms after release"


@dataclass(frozen=True)
class SolidFields:
    """Fields of a solid during contact, at the recorded time steps.

    ``mesh`` is the upright mesh with the tip at z = 0, on the communicator of the computation.
    ``facet_tags`` mark its boundary by `bristle.meshes.geometry.Tag`. ``displacement`` (m) leads
    from the upright mesh to the body's present position, rigid rotation included; ``velocity`` is
    in m/s. Both are along the world's axes: z points up, and the origin is where the tip first
    touches. ``stress`` (3, 3) in Pa is along the body's own axes; at finite strain it is the second
    Piola-Kirchhoff stress. All are Lagrange functions of the solid's order.
    """

    mesh: Mesh
    facet_tags: MeshTags
    times_s: Array
    displacement: Series
    velocity: Series
    stress: Series

    def __repr__(self) -> str:
        cells = self.mesh.topology.index_map(3).size_global
        return f"Fields of {cells} cells: {self.displacement!r}"


@dataclass(frozen=True)
class _Instant:
    t_s: float
    u: Array
    v: Array
    pose: Pose


class FieldRecorder:
    """Records the states of a solid during contact: an observer of ``simulate``.

    It records the first step of contact and every ``every``-th after it. Beyond ``most`` records it
    drops every second one and doubles ``every``.
    """

    def __init__(
        self, solid: SolidBody, marcher: ContactMarch, every: int = 1, most: int = MOST_FRAMES
    ) -> None:
        self.solid, self._marcher = solid, marcher
        self._every, self._most, self._seen = every, most, 0
        self._kept: list[_Instant] = []
        self._origin_m: Array | None = None

    def __call__(self, state: Moving, step_force: Array) -> None:
        placement: Placement = self._marcher.ground
        if self._origin_m is None:
            self._origin_m = placement.nearest(self.solid.contact)[0]
        if self._seen % self._every == 0:
            own = state.u.copy(), state.v.copy()
            self._kept.append(_Instant(state.t_s, *own, placement.pose))
        if len(self._kept) > self._most:
            del self._kept[1::2]
            self._every *= 2
        self._seen += 1

    def memory(self) -> dict[str, Array]:
        """Nothing: after a restart, recording begins anew."""
        return {}

    def recall(self, mark: Mark, state: Moving) -> None:
        """Nothing to restore."""

    def fields(self) -> SolidFields:
        """The recorded fields; each Function is made when it is asked for."""
        solid, kept = self.solid, self._kept
        origin = self._origin_m
        times_s = np.array([each.t_s for each in kept])
        body = fem.Function(solid.space)
        tensors = fem.functionspace(solid.domain, ("Lagrange", solid.order, (3, 3)))
        finite = isinstance(self._marcher, FiniteMarcher)
        stress_of: list[NodalStress] = []  # compiled on first use

        def displacement(i: int) -> fem.Function:
            assert origin is not None
            return made("displacement_m", carried(solid, kept[i].u, kept[i].pose, origin))

        def velocity(i: int) -> fem.Function:
            return made("velocity_m_s", turned(kept[i].v, kept[i].pose))

        def stress(i: int) -> fem.Function:
            if not stress_of:
                stress_of.append(NodalStress(body, solid.material, finite=finite))
            own_values(body, kept[i].u)
            found = fem.Function(tensors, name="stress_Pa")
            found.x.array[:] = stress_of[0]()[:, TENSOR].ravel()
            return found

        def made(name: str, values: Array) -> fem.Function:
            found = fem.Function(solid.space, name=name)
            own_values(found, values)
            return found

        series = (Series(times_s, each) for each in (displacement, velocity, stress))
        return SolidFields(solid.domain, solid.facet_tags, times_s, *series)
