"""A rough surface, drawn at random: heights, slopes and stiffness under a bristle's tip.

A `Surface` is a tile that repeats in x and y without end.  It is rigid in shape, a height over
z = 0; what gives way is the local contact law, whose stiffness follows the phase that is touched.
Vanegas-Useche, Abdel-Wahab and Parker, CMC 56(1), 2018, name it as what a better model needs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage
from scipy.interpolate import NdBSpline

from ...solver.arrays import Array
from .heights import Roughness, random_heights
from .phases import Composite, random_phases

FEWEST_NODES = 4
"""Along each side: a cubic spline spans four."""


@dataclass(frozen=True)
class Patch:
    """A surface seen at n places.

    heights_m (n,), unit normals (n, 3) that point up, and the numbers of the phases (n,).
    """

    heights_m: Array
    normals: Array
    phase: npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Surface:
    """A periodic height field and the phases on it.

    Node (j, i) is at x = i spacing, y = j spacing, and the tile repeats after nx and ny spacings.
    Between nodes the height is the periodic bicubic spline, whose slope and curvature are
    continuous; the phase is that of the nearest node.  The arrays cannot be written to.

    Parameters
    ----------
    heights_m : (ny, nx), m, finite; `FEWEST_NODES` or more along each side
    spacing_m : grid spacing in x and y, m
    phase : (ny, nx), which of the composite's phases is at each node
    composite : the phases
    """

    heights_m: Array
    spacing_m: float
    phase: npt.NDArray[np.uint8]
    composite: Composite

    def __post_init__(self) -> None:
        for name, kind in (("heights_m", float), ("phase", np.uint8)):
            array = np.array(getattr(self, name), dtype=kind)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def size_m(self) -> tuple[float, float]:
        """Periods in x and y, m."""
        ny, nx = self.heights_m.shape
        return nx * self.spacing_m, ny * self.spacing_m

    @cached_property
    def _coefficients(self) -> Array:
        return ndimage.spline_filter(self.heights_m, order=3, mode="grid-wrap")

    @cached_property
    def _spline(self) -> NdBSpline:
        """Height over (y, x) in spacings, each from 0 to the number of nodes."""
        # The B-spline centred on a node reaches two spacings to either side.
        knots = tuple(np.arange(n + 7.0) - 3.0 for n in self.heights_m.shape)
        return NdBSpline(knots, np.pad(self._coefficients, (1, 2), mode="wrap"), 3)

    def patch(self, x_m: Array, y_m: Array) -> Patch:
        """See the surface at places (x, y), m, each (n,) and anywhere in the plane.

        The normals are those of the very heights that are returned: (-∂h/∂x, -∂h/∂y, 1), to unit
        length.
        """
        places = np.mod(np.column_stack([y_m, x_m]) / self.spacing_m, self.heights_m.shape)
        rise_x = self._spline(places, nu=(0, 1)) / self.spacing_m
        rise_y = self._spline(places, nu=(1, 0)) / self.spacing_m
        normals = np.column_stack([-rise_x, -rise_y, np.ones_like(rise_x)])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        j, i = np.mod(np.floor(places + 0.5).astype(np.intp), self.heights_m.shape).T
        return Patch(self._spline(places), normals, self.phase[j, i])

    @property
    def fractions(self) -> Array:
        """Part of the area that each phase of the composite has, shape (phases,)."""
        counts = np.bincount(self.phase.ravel(), minlength=len(self.composite.phases))
        return counts / self.phase.size

    def stiffness_factors(self, bristle_youngs_Pa: float, bristle_poisson: float) -> Array:
        """Contact stiffness of each phase over that of the whole surface, shape (phases,).

        Contact stiffness is proportional to the contact modulus.  The factor's area-mean is 1, so
        that Kn remains the surface's mean stiffness.
        """
        moduli = self.composite.contact_moduli_Pa(bristle_youngs_Pa, bristle_poisson)
        return moduli / (self.fractions @ moduli)

    def rms_slope(self, axis: int) -> float:
        """Root mean square over the nodes of the spline's slope along an axis: 0 is y, 1 is x."""
        slope = ndimage.correlate1d(self._coefficients, [-0.5, 0, 0.5], axis, mode="wrap")
        slope = ndimage.correlate1d(slope, [1 / 6, 4 / 6, 1 / 6], 1 - axis, mode="wrap")
        return math.sqrt(np.mean(np.square(slope))) / self.spacing_m

    def correlation_length_m(self) -> float | None:
        """Where the autocorrelation, averaged over directions, first falls to 1/e.

        None for a plane, or where it never does within half the tile.
        """
        ny, nx = self.heights_m.shape
        deviation = self.heights_m - self.heights_m.mean()
        variance = np.mean(deviation**2)
        if variance <= (1e-12 * np.abs(self.heights_m).max()) ** 2:
            return None
        power = np.abs(fft.rfft2(deviation)) ** 2
        correlation = fft.irfft2(power, s=(ny, nx)) / (variance * deviation.size)
        lag = np.hypot(*np.meshgrid(fft.fftfreq(nx, 1 / nx), fft.fftfreq(ny, 1 / ny)))
        ring = np.rint(lag).astype(int).ravel()
        counts = np.bincount(ring)
        radius = np.bincount(ring, lag.ravel()) / counts
        mean = np.bincount(ring, correlation.ravel()) / counts
        fallen = np.flatnonzero(mean[: min(nx, ny) // 2 + 1] <= 1 / math.e)
        if not len(fallen):
            return None
        last = slice(fallen[0] - 1, fallen[0] + 1)
        return float(np.interp(-1 / math.e, -mean[last], radius[last])) * self.spacing_m


def make_surface(
    roughness: Roughness, composite: Composite, size_m: float, spacing_m: float, seed: int
) -> Surface:
    """Draw a square surface; the same seed gives the same surface.

    Heights and phases are independent, and each depends on the seed and its own parameters alone.

    Parameters
    ----------
    size_m : period, m: a whole number of spacings, and at least `Roughness.shortest_period_m`
    spacing_m : grid spacing, m: at most a third of the correlation length and of any grain
    seed : from 0

    Raises
    ------
    ValueError : a value is out of its range; the words say what would do
    """
    for_heights, for_phases = np.random.default_rng(seed).spawn(2)
    heights = random_heights(roughness, size_m, spacing_m, for_heights)
    phase = random_phases(composite, heights.shape, spacing_m, for_phases)
    return Surface(heights, spacing_m, phase, composite)
