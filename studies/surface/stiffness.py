"""Contact stiffness of one phase of a surface over that of the whole."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...meshes.section import require_positive

Array = npt.NDArray[np.floating]


def contact_modulus_Pa(
    youngs_Pa: npt.ArrayLike,
    poisson: npt.ArrayLike,
    bristle_youngs_Pa: float,
    bristle_poisson: float,
) -> Array:
    """Plane-strain contact modulus E* of surface and bristle, Pa, in the shape of the arguments.

    1/E* = (1 - ν1²)/E1 + (1 - ν2²)/E2: Johnson, Contact Mechanics, 1985, section 4.2.
    """
    surface = (1 - np.square(poisson)) / np.asarray(youngs_Pa, dtype=float)
    return 1 / (surface + (1 - bristle_poisson**2) / bristle_youngs_Pa)


def contact_stiffness_factor(
    youngs_Pa: npt.ArrayLike,
    poisson: npt.ArrayLike,
    bristle_youngs_Pa: float,
    bristle_poisson: float,
    mean_modulus_Pa: float,
) -> Array:
    """Local contact stiffness over its mean on the surface, in the shape of the arguments.

    Contact stiffness is proportional to E* (`contact_modulus_Pa`).  With `mean_modulus_Pa` from
    `Surface.mean_contact_modulus_Pa` the factor's area-mean over the surface is 1, so that Kn
    remains the surface's mean stiffness.

    Raises
    ------
    ValueError : the mean is not positive
    """
    require_positive("mean_modulus_Pa", mean_modulus_Pa)
    local = contact_modulus_Pa(youngs_Pa, poisson, bristle_youngs_Pa, bristle_poisson)
    return local / mean_modulus_Pa
