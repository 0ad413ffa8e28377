"""A rough surface, drawn at random: heights, slopes and stiffness under a bristle's tip.

A `Surface` is a tile that repeats in x and y without end.  It is rigid in shape, a height over
z = 0; what gives way is the local contact law, whose stiffness follows the phase that is touched.
Vanegas-Useche, Abdel-Wahab and Parker, CMC 56(1), 2018, name it as what a better model needs.

Its heights are a stationary Gaussian field on a torus, made by filtering white noise (FFT) with the
square root of the spectrum of the wanted autocorrelation, summed over the periodic images.  Sums of
images of a positive definite function are positive definite, so what the field has on the grid is
that autocorrelation itself, not an approximation to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage
from scipy.interpolate import NdBSpline

from ...meshes.section import require_positive
from ...solver.arrays import Array
from .phases import Composite, random_phases

CELLS_PER_CORRELATION_LENGTH = 3
"""Fewest: at the grid's Nyquist wavenumber the Gaussian's spectrum has then fallen to 2e-10."""
LARGEST_TAIL = 1e-3
"""Autocorrelation that may be left at half the period, where the periodic image takes over."""
SMALLEST_IMAGE = 1e-12
"""Images of the autocorrelation are summed until they are below this."""
MAX_NODES = 4096**2
FEWEST_NODES = 4
"""Along each side: a cubic spline spans four."""


@dataclass(frozen=True)
class Roughness:
    """A stationary, isotropic Gaussian rough surface; its mean plane is z = 0.

    The autocorrelation is exp(-(r / l)²).

    Parameters
    ----------
    rms_height_m : root of the mean square height, m; 0 is a plane
    correlation_length_m : l, where the autocorrelation has fallen to 1/e, m

    Raises
    ------
    ValueError : a value is not a number or out of its range
    """

    rms_height_m: float
    correlation_length_m: float

    def __post_init__(self) -> None:
        if isinstance(self.rms_height_m, bool) or self.rms_height_m != 0:
            require_positive("rms_height_m", self.rms_height_m)
        require_positive("correlation_length_m", self.correlation_length_m)

    def autocorrelation(self, distance_m: npt.ArrayLike) -> Array:
        """Correlation of the heights at two places this far apart, in the shape of the argument."""
        return np.exp(-np.square(np.asarray(distance_m, float) / self.correlation_length_m))

    @property
    def shortest_period_m(self) -> float:
        """Length of the smallest tile that can carry it, m: see `LARGEST_TAIL`."""
        return 2 * self.correlation_length_m * math.sqrt(-math.log(LARGEST_TAIL))


def node_count(size_m: float, spacing_m: float) -> int:
    """Return how many nodes a periodic tile has along one side.

    Raises
    ------
    ValueError : the size is no whole number of spacings, or makes more than `MAX_NODES` nodes
    """
    require_positive("size_m", size_m)
    require_positive("spacing_m", spacing_m)
    count = round(size_m / spacing_m)
    if not math.isclose(count * spacing_m, size_m, rel_tol=1e-6):
        raise ValueError(f"size_m {size_m:g} is not a whole number of spacings of {spacing_m:g} m.")
    if count**2 > MAX_NODES:
        raise ValueError(
            f"size_m {size_m:g} at spacing_m {spacing_m:g} makes {count} × {count} nodes; "
            f"{MAX_NODES} is the most."
        )
    return count


def random_heights(
    roughness: Roughness, size_m: float, spacing_m: float, rng: np.random.Generator
) -> Array:
    """Draw the heights of a periodic square tile.

    Over the draws the mean square height is rms² and the autocorrelation the roughness's, both
    about z = 0, the mean plane of the whole surface: one tile's own mean is not exactly 0.

    Parameters
    ----------
    size_m, spacing_m : period and grid spacing, m
    rng : source of n² standard normal numbers

    Returns
    -------
    heights : (n, n), m

    Raises
    ------
    ValueError : the tile is too short or the grid too coarse for the correlation length, or see
        `node_count`
    """
    n = node_count(size_m, spacing_m)
    length = roughness.correlation_length_m
    if roughness.rms_height_m == 0:
        return np.zeros((n, n))
    if size_m < roughness.shortest_period_m * (1 - 1e-9):
        raise ValueError(
            f"size_m {size_m:g} is too short to repeat: with a correlation length of {length:g} m "
            f"it must be at least {roughness.shortest_period_m:.4g} m."
        )
    if spacing_m * CELLS_PER_CORRELATION_LENGTH > length * (1 + 1e-9):
        raise ValueError(
            f"spacing_m {spacing_m:g} is too coarse: with a correlation length of {length:g} m "
            f"it must be at most {length / CELLS_PER_CORRELATION_LENGTH:.4g} m."
        )
    # Of a symmetric sequence: real.  Below zero only by rounding and by the images left out.
    spectrum = np.maximum(fft.fft2(_periodic_autocorrelation(roughness, n, spacing_m)).real, 0.0)
    spectrum *= (n * roughness.rms_height_m) ** 2 / spectrum.sum()
    noise = fft.rfft2(rng.standard_normal((n, n)))
    return fft.irfft2(noise * np.sqrt(spectrum[:, : n // 2 + 1]), s=(n, n))


def _periodic_autocorrelation(roughness: Roughness, n: int, spacing_m: float) -> Array:
    """Sum of the autocorrelation's images: (n, n), from lag 0, each axis wrapping."""
    size_m = n * spacing_m
    reach = roughness.correlation_length_m * math.sqrt(-math.log(SMALLEST_IMAGE))
    images = np.arange(-(n_images := math.ceil(reach / size_m)), n_images + 1) * size_m
    lags = np.arange(n // 2 + 1) * spacing_m
    quadrant = np.zeros((len(lags), len(lags)))
    for shift_y in images:
        for shift_x in images:
            distance = np.hypot(lags[:, None] + shift_y, lags + shift_x)
            quadrant += roughness.autocorrelation(distance)
    nearest = np.minimum(np.arange(n), n - np.arange(n))
    return quadrant[np.ix_(nearest, nearest)]


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
