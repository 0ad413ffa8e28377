"""Random heights of a rough surface at the nodes of its grid.

A stationary Gaussian field on a torus, made by filtering white noise (FFT) with the square root of
the spectrum of the wanted autocorrelation, summed over the periodic images.  Sums of images of a
positive definite function are positive definite, so what the field has on the grid is that
autocorrelation itself, not an approximation to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import fft

from ...meshes.section import require_positive

CELLS_PER_CORRELATION_LENGTH = 3
"""Fewest: at the grid's Nyquist wavenumber the Gaussian's spectrum has then fallen to 2e-10."""
LARGEST_TAIL = 1e-3
"""Autocorrelation that may be left at half the period, where the periodic image takes over."""
SMALLEST_IMAGE = 1e-12
"""Images of the autocorrelation are summed until they are below this."""
MAX_NODES = 4096**2


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

    def autocorrelation(self, distance_m: npt.ArrayLike) -> npt.NDArray[np.float64]:
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
) -> npt.NDArray[np.float64]:
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


def _periodic_autocorrelation(
    roughness: Roughness, n: int, spacing_m: float
) -> npt.NDArray[np.float64]:
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
