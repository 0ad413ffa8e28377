"""Inputs as command-line flags: each is declared once, as a field of a pydantic model.

A field's annotation has its type and bounds, `option` its default and the help of its flag. The
flag's name is the field's without its unit, its panel that of the class (``class Fields(…,
group=…)``).
Nothing heavy is imported here, so that help is quick.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from inspect import get_annotations
from types import NoneType, UnionType
from typing import Any, ClassVar, NoReturn, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

# Ends of fields' names, the longest first, and the unit that they stand for.
UNITS = {
    "_kg_m3": "kg/m³",
    "_m_s2": "m/s²",
    "_m_s": "m/s",
    "_N_m": "N/m",
    "_1_s": "1/s",
    "_deg": "degrees",
    "_Pa": "Pa",
    "_N": "N",
    "_m": "m",
    "_s": "s",
}
# As a command line shows it, in capitals and without exponents.
PLAIN = str.maketrans("²³", "23")


class Fields(BaseModel):
    """Base of inputs: they are frozen, and have no other fields than those declared.

    ``group`` is the panel of help for the fields of a class.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)
    group: ClassVar[str] = ""

    def __init_subclass__(cls, group: str = "", **more: Any) -> None:
        super().__init_subclass__(**more)
        cls.group = group


def refuse(field: str, message: str) -> NoReturn:
    """End validation with a message about ``field``."""
    raise PydanticCustomError("bristle", "{message}", {"field": field, "message": message})


def option(
    default: Any,
    help: str,
    metavar: str | None = None,
    shown: str | None = None,
    kind: Any = None,
    *,
    name: str = "",
    group: str = "",
    alias: str | None = None,
) -> Any:
    """A field with a ``default`` that is an option of the command line.

    ``shown`` stands for a default that another option decides; ``kind`` is what the command line
    parses where that is not the field's own type; ``name`` (without dashes) and ``group`` where
    they are not what the field's name and class say; ``alias`` is a further spelling, with dashes.
    """
    said: Any = Flag("", default, help, metavar, shown, kind, name, group, alias)
    return Field(default, description=help, json_schema_extra={"flag": said})


@dataclass(frozen=True)
class Flag:
    """What the command line says of a ``field``, as `option` takes it; ``kind`` is a type, an enum,
    or a tuple of types."""

    field: str
    default: Any
    help: str
    metavar: str | None
    shown: str | None
    kind: Any
    name: str
    group: str
    alias: str | None

    @property
    def option(self) -> str:
        return f"--{self.name}"

    @property
    def parameter(self) -> str:
        return self.name.replace("-", "_")

    @property
    def spellings(self) -> tuple[str, ...]:
        """The flag as it may stand on the command line."""
        return (self.option, *([self.alias] if self.alias else []))

    @property
    def is_choice(self) -> bool:
        """Whether it is one of an enum."""
        return isinstance(self.kind, type) and issubclass(self.kind, StrEnum)

    @property
    def may_be_several(self) -> bool:
        """Whether it is a number or a choice, of which a sweep takes several."""
        return self.kind in (int, float) or self.is_choice

    def default_text(self) -> str:
        """The default as help shows it, or an empty text."""
        if self.shown is not None or self.default is None:
            return self.shown or ""
        if isinstance(self.default, tuple):
            return " ".join(map(str, self.default))
        if isinstance(self.default, bool):
            return ""
        return f"{self.default:g}" if isinstance(self.default, float) else str(self.default)


def unit_of(field: str) -> str:
    """The end of a field's name that says its unit, or an empty text."""
    return next((end for end in UNITS if field.endswith(end)), "")


def flags_of(*models: type[Fields], only: tuple[str, ...] = ()) -> tuple[Flag, ...]:
    """The flags of the fields that are an `option`, each once; ``only`` those of these names."""
    found: dict[str, Flag] = {}
    for model in models:
        for name, field in model.model_fields.items():
            extra: Any = field.json_schema_extra or {}
            if "flag" in extra:
                found.setdefault(name, _complete(extra["flag"], model, name))
    return tuple(flag for flag in found.values() if not only or flag.name in only)


def _complete(flag: Flag, model: type[Fields], field: str) -> Flag:
    """The flag with what the field of a model says of it."""
    unit = unit_of(field)
    owner = next(each for each in model.__mro__ if field in get_annotations(each))
    return replace(
        flag,
        field=field,
        name=flag.name or field.removesuffix(unit).replace("_", "-"),
        group=flag.group or getattr(owner, "group", ""),
        metavar=flag.metavar or UNITS.get(unit, "").upper().translate(PLAIN) or None,
        kind=flag.kind or _kind(model.model_fields[field].annotation),
    )


def several(flags: tuple[Flag, ...]) -> tuple[Flag, ...]:
    """The same flags, those of numbers and choices as texts that may hold several."""

    def of(flag: Flag) -> Flag:
        one = flag.metavar or ("|".join(flag.kind) if flag.is_choice else "NUMBER")
        return replace(flag, kind=str, metavar=f"{one},…")

    return tuple(of(flag) if flag.may_be_several else flag for flag in flags)


def _kind(annotation: Any) -> Any:
    """What the command line parses for a field of this type: without None, and plain."""
    if get_origin(annotation) in (Union, UnionType):
        (annotation,) = (each for each in get_args(annotation) if each is not NoneType)
    if get_origin(annotation) is tuple:
        return tuple(map(_plain, get_args(annotation)))
    return _plain(annotation)


def _plain(kind: Any) -> Any:
    """A type without what is annotated on it."""
    return get_args(kind)[0] if hasattr(kind, "__metadata__") else kind
