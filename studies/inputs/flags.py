"""Inputs as command-line flags: each is declared once, as a field of a pydantic model.

A field's annotation has its type and bounds and an `Option`: name, group and help of its flag.
Nothing heavy is imported here, so that help is quick.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo


@dataclass(frozen=True)
class Option:
    """What the command line says of a field: the flag's ``name`` without dashes, its panel, help.

    ``shown`` stands for a default that another option decides; ``kind`` is what the command line
    parses where that is not the field's own type.
    """

    name: str
    group: str
    help: str
    metavar: str | None = None
    shown: str | None = None
    alias: str | None = None
    kind: Any = None


@dataclass(frozen=True)
class Flag:
    """An `Option` of a ``field`` with that one's default; ``kind`` is a type, an enum, or a tuple
    of types."""

    declared: Option
    field: str
    kind: Any
    default: Any

    @property
    def name(self) -> str:
        return self.declared.name

    @property
    def option(self) -> str:
        return f"--{self.name}"

    @property
    def parameter(self) -> str:
        return self.name.replace("-", "_")

    @property
    def spellings(self) -> tuple[str, ...]:
        """The flag as it may stand on the command line."""
        return (self.option, *([self.declared.alias] if self.declared.alias else []))

    @property
    def may_be_several(self) -> bool:
        """Whether it is a number or a choice, of which a sweep takes several."""
        return self.kind in (int, float) or (
            isinstance(self.kind, type) and issubclass(self.kind, StrEnum)
        )

    def default_text(self) -> str:
        """The default as help shows it, or an empty text."""
        if self.declared.shown is not None or self.default is None:
            return self.declared.shown or ""
        if isinstance(self.default, tuple):
            return " ".join(map(str, self.default))
        if isinstance(self.default, bool):
            return ""
        if isinstance(self.default, StrEnum):
            return self.default.value
        return f"{self.default:g}" if isinstance(self.default, float) else str(self.default)


def flags_of(*models: type[BaseModel], only: tuple[str, ...] = ()) -> tuple[Flag, ...]:
    """The flags of the fields that have an `Option`, each once; ``only`` those of these names."""
    found: dict[str, Flag] = {}
    for model in models:
        for name, field in model.model_fields.items():
            for said in field.metadata:
                if isinstance(said, Option) and (not only or said.name in only):
                    found.setdefault(name, Flag(said, name, _kind(said, field), field.default))
    return tuple(found.values())


def several(flags: tuple[Flag, ...]) -> tuple[Flag, ...]:
    """The same flags, those of numbers and choices as texts that may hold several."""
    return tuple(
        replace(
            flag,
            kind=str,
            declared=replace(flag.declared, metavar=f"{flag.declared.metavar or _choices(flag)},…"),
        )
        if flag.may_be_several
        else flag
        for flag in flags
    )


def _choices(flag: Flag) -> str:
    return "NUMBER" if flag.kind in (int, float) else "|".join(flag.kind)


def _kind(said: Option, field: FieldInfo) -> Any:
    """What the command line parses for a field."""
    if said.kind is not None:
        return said.kind
    kind = field.annotation
    if get_origin(kind) in (Union, UnionType):
        (kind,) = (each for each in get_args(kind) if each is not NoneType)
    if get_origin(kind) is tuple:
        return tuple(_plain(each) for each in get_args(kind))
    return _plain(kind)


def _plain(kind: Any) -> Any:
    """A type without what is annotated on it."""
    return get_args(kind)[0] if hasattr(kind, "__metadata__") else kind
