"""What is a scatter asked to do: which bristle, how it is released, over which surface?"""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from ...solver import paper
from ..command.choices import Contact, Model, Scheme, Until
from ..command.config import DropInputs, Height, Inputs, Its, Kn, Truth, between, refuse, whole
from ..command.sources import checked
from ..running.study import Numbers
from . import flags as flags

MOST_DROPS = 1_000_000
SEEDS = 2**32 - 1
# Beyond it a normal lean would reach what cannot land on the end face.
MOST_TILT_STD_DEG = 15.0
# Inputs of a drop that a scatter has no use for, and why.
FIXED: dict[str, tuple[Any, str]] = {
    "slope_deg": (0.0, "the slope comes from the surface; lean the bristle by --tilt"),
    "slope_wide_deg": (0.0, "the slope comes from the surface; lean the bristle by --tilt-wide"),
    "until": (Until.REBOUND, "every drop ends after its rebound"),
    "march": (False, "flight is exact here"),
    "effects": ((), "no effect can be switched on here yet"),
    "scheme": (Scheme.AVERAGE, "many drops at once have the conserving scheme only"),
    "alpha_1_s": (0.0, "many drops at once have no damping in proportion to mass"),
}


class ScatterInputs(Inputs):
    """Every option of `bristle scatter`, resolved and checked.

    ``tilt_deg`` and ``tilt_wide_deg`` are the means about which the lean scatters.
    """

    model: Model = Model.REDUCED
    kn_N_m: Kn = paper.KN_CHOSEN_N_M
    heights_m: Annotated[tuple[Height, ...], Numbers, Field(min_length=1)] = paper.HEIGHTS_M
    its_s: Its = paper.ITS_S
    drops: Annotated[int, whole(1, MOST_DROPS)] = flags.DROPS
    seed: Annotated[int, whole(0, SEEDS)] = 0
    tilt_std_deg: Annotated[float, between(0.0, MOST_TILT_STD_DEG)] = flags.TILT_STD_DEG
    rms_height_m: Annotated[float, between(0.0, 0.1)] | None = None
    correlation_length_m: Annotated[float, between(1e-6, 1.0)] | None = None
    surface: Annotated[str, Field(min_length=1)] | None = None
    surface_seed: Annotated[int, whole(0, SEEDS)] = 0
    flat: Truth = False

    @model_validator(mode="before")
    @classmethod
    def _surface(cls, data: Any) -> Any:
        """Fill in the roughness of a surface that is made."""
        if isinstance(data, dict) and not data.get("flat") and data.get("surface") is None:
            made = {
                "rms_height_m": flags.RMS_HEIGHT_M,
                "correlation_length_m": flags.CORRELATION_LENGTH_M,
            }
            data = {**data, **{key: value for key, value in made.items() if data.get(key) is None}}
        return data

    @model_validator(mode="after")
    def _possible(self) -> Self:
        """Refuse what many drops at once cannot do."""
        if self.model not in (Model.BEAM, Model.REDUCED):
            refuse("model", f"a scatter takes beam or reduced, not {self.model}")
        if self.contact is Contact.NITSCHE:
            refuse("contact", "a scatter takes penalty or augmented")
        if self.kn_N_m == float("inf"):
            refuse("kn_N_m", "a scatter needs a finite stiffness")
        for field, (value, why) in FIXED.items():
            if getattr(self, field) != value:
                refuse(field, why)
        if self.flat and self.surface is not None:
            refuse("flat", "a plane needs no --surface")
        for field in ("rms_height_m", "correlation_length_m"):
            if getattr(self, field) is not None and (self.flat or self.surface is not None):
                given = "--flat" if self.flat else "--surface"
                refuse(field, f"has no meaning with {given}, which says what the surface is")
        return self

    @property
    def upright(self) -> bool:
        """Whether nothing can push the tip aside: see `Inputs.leaning`."""
        return self.flat and not self.tilt_std_deg and not self.leaning

    def drop(self) -> DropInputs:
        """One drop of these, from the greatest height: its body, contact and ITS are everyone's.

        It leans where any of them can. Raises InputError where it is impossible.
        """
        own = set(ScatterInputs.model_fields) - set(Inputs.model_fields)
        values = self.model_dump(exclude=own)
        values |= {"model": self.model, "kn_N_m": self.kn_N_m, "its_s": self.its_s}
        values["height_m"] = max(self.heights_m)
        if not self.upright and not self.leaning:
            values["tilt_deg"] = self.tilt_std_deg or 1.0
        return checked(DropInputs, values)
