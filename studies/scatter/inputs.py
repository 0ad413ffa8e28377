"""Inputs of a scatter: the bristle, how it is released, and over which surface."""

from __future__ import annotations

from typing import Any, Self

from pydantic import model_validator

from ..inputs import study_fields as fields
from ..inputs.choices import Contact, Model, Scheme, Until
from ..inputs.config import DropInputs, Inputs, fill_in
from ..inputs.fields import HeightsField, StepField
from ..inputs.flags import refuse
from ..inputs.sources import checked
from ..inputs.study_fields import ScatterFields

# Inputs of a drop that a scatter has no use for, and why.
FIXED: dict[str, tuple[Any, str]] = {
    "slope_deg": (0.0, "the slope comes from the surface; lean the bristle by --tilt"),
    "slope_wide_deg": (0.0, "the slope comes from the surface; lean the bristle by --tilt-wide"),
    "until": (Until.REBOUND, "every drop ends after its rebound"),
    "effects": ((), "no effect can be switched on here yet"),
    "scheme": (Scheme.AVERAGE, "many drops at once have the conserving scheme only"),
    "alpha_1_s": (0.0, "many drops at once have no damping in proportion to mass"),
}


class ScatterInputs(Inputs, ScatterFields, HeightsField, StepField):
    """Every option of `bristle scatter`, resolved and checked.

    ``tilt_deg`` and ``tilt_wide_deg`` are the means about which the lean scatters.
    """

    @model_validator(mode="before")
    @classmethod
    def _surface(cls, data: Any) -> Any:
        """Fill in the roughness of a surface that is made."""
        if isinstance(data, dict) and not data.get("flat") and data.get("surface") is None:
            data = dict(data)
            length_m = fields.CORRELATION_LENGTH_M
            fill_in(data, rms_height_m=fields.RMS_HEIGHT_M, correlation_length_m=length_m)
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
