"""Which options does `bristle scatter` have beyond those of a drop, and why those defaults?"""

from __future__ import annotations

from dataclasses import replace

from ..command.choices import Model
from ..command.flags import (
    BODY_FLAGS,
    CONTACT_FLAGS,
    DISCRETISATION_FLAGS,
    ITS_FLAG,
    KN_FLAG,
    LISTS_FLAGS,
    MATERIAL_FLAGS,
    MODEL,
    PLACE_FLAGS,
    Flag,
)

RANDOM, SURFACE = "Random drops", "Surface"

DROPS = 2000
# Assumed: the upper end 6 mm beside the lower one, about what an eye without an instrument sees.
TILT_STD_DEG = 1.0
# Macrotexture has wavelengths of 0.5 to 50 mm and heights of 0.2 to 10 mm (PIARC; ISO 13473-1).
# Assumed: a trowelled slab, whose heights just reach that (4 rms = 0.2 mm), and the geometric mean
# of the wavelengths. Its slope is then 0.8 degrees rms toward each side.
RMS_HEIGHT_M = 50e-6
CORRELATION_LENGTH_M = 5e-3

_TAKEN = ("deflection", "tip", "friction", "kt-ratio", "tip-shape", "contact-points")
_PLACES = ("gravity", "tilt", "tilt-wide")

OWN_FLAGS = (
    Flag("drops", "drops", int, DROPS, RANDOM, "How many drops.", "N"),
    Flag("seed", "seed", int, 0, RANDOM, "Seed of all that is drawn for each drop.", "N"),
    Flag(
        "tilt-std",
        "tilt_std_deg",
        float,
        TILT_STD_DEG,
        RANDOM,
        "Standard deviation of the lean at release toward the thin and, independently, the wide "
        "side, about --tilt and --tilt-wide. An assumption: 1 degree puts the upper end 6 mm "
        "beside the lower one, about what an eye sees.",
        "DEGREES",
    ),
    Flag(
        "rms-height",
        "rms_height_m",
        float,
        None,
        SURFACE,
        "Root mean square height of the surface. An assumption: four of it make 0.2 mm, the least "
        "height of macrotexture (PIARC), as of a trowelled slab.",
        "M",
        f"{RMS_HEIGHT_M:g}",
    ),
    Flag(
        "correlation-length",
        "correlation_length_m",
        float,
        None,
        SURFACE,
        "Where the heights' correlation has fallen to 1/e. An assumption: the geometric mean of "
        "macrotexture's wavelengths, 0.5 to 50 mm (PIARC).",
        "M",
        f"{CORRELATION_LENGTH_M:g}",
    ),
    Flag(
        "surface",
        "surface",
        str,
        None,
        SURFACE,
        "A measured surface instead, in m: .npz, .csv or .txt, see bristle.studies.surface.files.",
        "FILE",
    ),
    Flag(
        "surface-seed",
        "surface_seed",
        int,
        0,
        SURFACE,
        "Seed of the surface's heights and phases.",
        "N",
    ),
    Flag("flat", "flat", bool, False, SURFACE, "A level plane of one material instead."),
)


def _named(flags: tuple[Flag, ...], names: tuple[str, ...]) -> tuple[Flag, ...]:
    return tuple(flag for flag in flags if flag.name in names)


MODEL_FLAG = Flag(
    "model",
    "model",
    Model,
    Model.REDUCED,
    MODEL,
    "reduced: the solid in a few modes; beam.",
    "[beam|reduced]",
)
# Less than a drop may take: no rigid plane, no Nitsche.
FINITE_KN_FLAG = replace(KN_FLAG, help="Normal contact stiffness.")
(CONTACT_FLAG,) = (
    replace(flag, metavar="[penalty|augmented]") for flag in CONTACT_FLAGS if flag.name == "contact"
)
HEIGHTS_FLAG = next(flag for flag in LISTS_FLAGS if flag.name == "heights")

SCATTER_FLAGS = (
    MODEL_FLAG,
    *OWN_FLAGS,
    FINITE_KN_FLAG,
    HEIGHTS_FLAG,
    ITS_FLAG,
    CONTACT_FLAG,
    *_named(CONTACT_FLAGS, _TAKEN),
    *BODY_FLAGS,
    *_named(MATERIAL_FLAGS, ("youngs", "poisson", "density", "beta")),
    *_named(PLACE_FLAGS, _PLACES),
    *DISCRETISATION_FLAGS,
)
