"""Inputs of `bristle scatter`, `calibrate`, `close-loop`, `synth` and `track` beyond a drop's."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import BeforeValidator, model_validator

from ...solver import paper
from .choices import Body, Contact, Down, Model, Noise, Strange
from .fields import (
    CONTACT,
    DROP,
    MODEL,
    BodyFields,
    Effects,
    Heights,
    HeightsField,
    Kn,
    Plugins,
    SharedFields,
    StepField,
    Truth,
    between,
    effect_option,
    listed,
    plugin_option,
    whole,
)
from .flags import Fields, flags_of, option, refuse
from .named import GivenFile

RANDOM, SURFACE, LOOP = "Random drops", "Surface", "Loop"
CALIBRATION, DATASET = "Calibration", "Dataset"
FILM = "Film"

DROPS, MOST_DROPS = 2000, 1_000_000
Pixel = Annotated[int, whole(0, 100_000)]
Side = Annotated[int, whole(1, 100_000)]
SEEDS = 2**32 - 1
# Rate of false alarms.
ALARM = 0.01
# Assumed: the upper end 6 mm beside the lower one, about what an eye without an instrument sees.
TILT_STD_DEG = 1.0
# Beyond it a normal lean would reach what cannot land on the end face.
MOST_TILT_STD_DEG = 15.0
# Macrotexture has wavelengths of 0.5 to 50 mm and heights of 0.2 to 10 mm (PIARC; ISO 13473-1).
# Assumed: a trowelled slab, whose heights just reach that (4 rms = 0.2 mm), and the geometric mean
# of the wavelengths. Its slope is then 0.8 degrees rms toward each side.
RMS_HEIGHT_M = 50e-6
CORRELATION_LENGTH_M = 5e-3


class ReliefFields(Fields, group=SURFACE):
    """A rough, composite surface, drawn at random or measured."""

    rms_height_m: Annotated[float, between(0.0, 0.1)] | None = option(
        None,
        "Root mean square height of the surface. The default is an assumption: four times it is "
        "0.2 mm, the least height of macrotexture (PIARC), as of a trowelled slab.",
        shown=f"{RMS_HEIGHT_M:g}",
    )
    correlation_length_m: Annotated[float, between(1e-6, 1.0)] | None = option(
        None,
        "Distance over which the correlation of the heights falls to 1/e. The default is an "
        "assumption: the geometric mean of macrotexture's wavelengths, 0.5 to 50 mm (PIARC).",
        shown=f"{CORRELATION_LENGTH_M:g}",
    )
    surface: Annotated[GivenFile | None, BeforeValidator(GivenFile.of)] = option(
        None,
        "A measured surface instead, .npz, .csv or .txt, in m. docs/drops.md shows the format.",
        "FILE",
        kind=str,
    )
    surface_seed: Annotated[int, whole(0, SEEDS)] = option(
        0, "Seed of the surface's heights and phases.", "N"
    )


class ScatterFields(ReliefFields, group=SURFACE):
    """How drops are released, over which surface, and what of a drop's inputs is narrower here."""

    model: Model = option(
        Model.REDUCED,
        "reduced: the 3-D solid in few unknowns; beam.",
        "[beam|reduced]",
        group=MODEL,
    )
    kn_N_m: Kn = option(paper.KN_CHOSEN_N_M, "Normal contact stiffness.", group=CONTACT)
    contact: Contact = option(
        Contact.PENALTY, "How contact is enforced.", "[penalty|augmented]", group=CONTACT
    )
    drops: Annotated[int, whole(1, MOST_DROPS)] = option(
        DROPS, "How many drops.", "N", group=RANDOM
    )
    seed: Annotated[int, whole(0, SEEDS)] = option(
        0, "Seed of all that is drawn for each drop.", "N", group=RANDOM
    )
    tilt_std_deg: Annotated[float, between(0.0, MOST_TILT_STD_DEG)] = option(
        TILT_STD_DEG,
        "Standard deviation of the lean at release about --tilt and --tilt-wide, for the thin "
        "and the wide side independently. The default is an assumption: 1 degree puts the upper "
        "end 6 mm beside the lower one, about what an eye sees.",
        group=RANDOM,
    )
    flat: Truth = option(False, "A level plane of one material instead.")


class LoopInputs(Fields, group=LOOP):
    """Every option of `bristle close-loop`, checked."""

    plugins: Plugins = plugin_option()
    seed: Annotated[int, whole(0, SEEDS)] = option(
        0, "Seed of the choice of held-out data, and of everything else that is drawn.", "N"
    )
    alarm: Annotated[float, between(1e-3, 0.3)] = option(
        ALARM,
        "How often the loop may report a missing effect although none is missing, over all tests.",
        "RATE",
    )
    no_3d: Truth = option(False, "Leave out the confirmation by the 3-D model.")


class CalibrateInputs(Fields, group=CALIBRATION):
    """Every option of `bristle calibrate`, checked."""

    seed: Annotated[int, whole(0, SEEDS)] = option(0, "Seed of the bootstrap.", "N")
    level: Annotated[float, between(0.5, 0.999)] = option(
        0.9, "Probability of the intervals.", "LEVEL"
    )


class TrackInputs(Fields, group=FILM):
    """Every option of `bristle track`, checked."""

    body: Body = option(Body.BRISTLE, "What falls: a bristle, or a ball.")
    diameter_mm: Annotated[float, between(0.1, 1e4)] | None = option(
        None, "Diameter of the ball. It gives the scale.", "MM"
    )
    mass_g: Annotated[float, between(1e-6, 1e9)] | None = option(
        None, "Mass of the ball.", "G", "that of steel"
    )
    length_mm: Annotated[float, between(1.0, 1e4)] | None = option(
        None,
        "Length of the bristle that falls. It gives the scale where both ends are in view. A ruler "
        "in view is not read: count the pixels along it and give the length of one.",
        "MM",
        "336.5, the paper's",
    )
    mm_per_px: Annotated[float, between(1e-4, 1e3)] | None = option(
        None,
        "Length of a pixel where the body falls, in place of a length in view. Gravity gives the "
        "scale too, and the mean of both is used.",
        "MM",
    )
    fps: Annotated[float, between(0.1, 1e6)] | None = option(
        None,
        "Frames a second. It overrides the film's own time stamps; a folder of pictures needs it.",
        "RATE",
    )
    roi: tuple[Pixel, Pixel, Side, Side] | None = option(
        None,
        "The part of the picture to look at: left edge, top edge, width and height in pixels.",
        "X Y W H",
    )
    down: Down = option(
        Down.AUTO,
        "Which way things fall in the picture; auto tries each.",
        "[auto|left|right|up|down]",
    )
    exposure_s: Annotated[float, between(0.0, 10.0)] | None = option(
        None,
        "Exposure of a frame in s.",
        "S",
        "what the blur of fast frames shows",
        name="exposure-s",
    )
    rolling_shutter_s_per_row: Annotated[float, between(-1e-2, 1e-2)] = option(
        0.0,
        "By how much later a row of the picture is taken than the row above it, in s.",
        "S",
    )
    gravity_m_s2: Annotated[float, between(0.01, 300.0)] = option(paper.GRAVITY_M_S2, "Gravity.")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        """Refuse what does not belong to the body."""
        if self.body is Body.BRISTLE:
            for field in ("diameter_mm", "mass_g"):
                if getattr(self, field) is not None:
                    refuse(field, "is for --body ball")
        elif self.length_mm is not None:
            refuse("length_mm", "is for --body bristle; a ball has --diameter-mm")
        return self


def read_unlisted(value: Any) -> Any:
    """An unlisted effect and its strength, also as ``NAME=STRENGTH``."""
    if not isinstance(value, str):
        return value
    name, _, strength = value.partition("=")
    try:
        found = Strange(name), float(strength)
    except ValueError:
        found = None
    if found is None or not abs(found[1]) < 1.0:
        raise ValueError(
            f"must be NAME=STRENGTH, NAME one of {', '.join(Strange)}, STRENGTH between -1 and 1, "
            f"not '{value}'"
        )
    return found


class Recipe(Fields, group=DATASET):
    """Every option of `bristle synth`, checked: what a made dataset holds."""

    plugins: Plugins = plugin_option()  # before the effects that may come from them
    effects: Effects = effect_option(
        "An effect that the dataset hides, repeatable, e.g. contact_damping:c_N_s_m=5."
    )
    unlisted: Annotated[tuple[Strange, float] | None, BeforeValidator(read_unlisted)] = option(
        None,
        f"A misfit that no effect explains: {', '.join(Strange)}. STRENGTH is its share of the "
        "height after the impact.",
        "NAME=STRENGTH",
        kind=str,
    )
    drops: Annotated[int, whole(6, 10_000)] = option(48, "How many drops.", "N")
    heights_m: Heights = listed(
        paper.HEIGHTS_M, "Heights of release", "M,…", group=DROP, alias="--height"
    )
    kn_N_m: Annotated[float, between(2e5, 5e7)] = option(
        paper.KN_CHOSEN_N_M, "Normal contact stiffness.", group=CONTACT
    )
    friction: Annotated[float, between(0.0, 100.0)] = option(
        paper.FRICTION,
        "Coulomb's coefficient. It acts where an effect makes the bristle lean.",
        "MU",
        group=CONTACT,
    )
    noise: Noise = option(Noise.GAUSSIAN, "Distribution of the errors of measurement.")
    sigma_y_m: Annotated[float, between(1e-6, 1e-2)] = option(3e-4, "Standard error of a height.")
    sigma_t_s: Annotated[float, between(1e-9, 1e-2)] = option(
        2e-6, "Standard error of a contact time."
    )
    sigma_force_N: Annotated[float, between(1e-6, 1e3)] = option(
        0.5, "Standard error of a peak force."
    )
    heights_only: Truth = option(False, "Leave out contact times and forces.")
    film: Truth = option(
        False, "Films of the drops instead of a table, one for each drop, for `bristle track`."
    )
    seed: Annotated[int, whole(0, SEEDS)] = option(
        0, "Seed of releases, random effects and errors.", "N"
    )


# What of a drop's other options many drops at once can have.
TAKEN = (
    *("deflection", "tip", "friction", "kt-ratio", "tip-shape", "contact-points"),
    *("youngs", "poisson", "density", "beta", "gravity", "tilt", "tilt-wide", "cells"),
    *("geometry-order", "grading", "elements", "order", "solver", "modes", "reduction-tolerance"),
)
OWN_FLAGS = flags_of(ScatterFields)
SCATTER_FLAGS = (
    *flags_of(ScatterFields, HeightsField, StepField, BodyFields),
    *flags_of(SharedFields, only=TAKEN),
)
LOOP_FLAGS = flags_of(LoopInputs)
CALIBRATE_FLAGS = flags_of(CalibrateInputs)
SYNTH_FLAGS = flags_of(Recipe)
TRACK_FLAGS = flags_of(TrackInputs)
