"""Signatures and docstrings of the Python functions, made from the declared inputs.

Of each input the declaration says type, bounds, unit, default and help (`inputs.fields`). Here it
becomes a parameter that `help`, completion, type checkers and Sphinx see.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import reduce
from operator import or_
from pathlib import Path
from textwrap import fill
from types import GenericAlias, NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from ...solver.effects.base import Effect
from ..inputs.flags import UNITS, Flag, unit_of
from ..inputs.named import EffectInput, GivenFile, MotionInput
from ..inputs.sources import OPTIONS

# Further names of inputs that take several, as they are called where there is one.
ALIASES = {"model": "models", "height_m": "heights_m"}
FIELDS = {option: name for name, option in OPTIONS.items()} | {
    "--no-fields": "write_fields=False",
    "--out": "out",
    "--truth": "truth",
}


@dataclass(frozen=True)
class Signature:
    """The inputs of a function: ``flags`` of a ``model``, of which it takes ``several`` at once."""

    model: type[BaseModel]
    flags: tuple[Flag, ...]
    several: Collection[str] = ()

    def aliases(self) -> dict[str, str]:
        """The names of `ALIASES` that this function takes."""
        there = {flag.field for flag in self.flags}
        return {one: many for one, many in ALIASES.items() if many in there and one not in there}

    def names(self) -> dict[str, str]:
        """Its inputs by the options of the command."""
        return {flag.option: flag.field for flag in self.flags}

    def parameters(self) -> list[inspect.Parameter]:
        """Each input as a keyword, as it is declared."""
        found = [_keyword(flag.field, self._kind(flag), self._default(flag)) for flag in self.flags]
        by_name = {each.name: each.annotation for each in found}
        return [
            *found,
            *(_keyword(one, by_name[many] | None, None) for one, many in self.aliases().items()),
        ]

    def described(self) -> str:
        """The inputs as numpydoc has them: type, unit, meaning, default."""
        lines: list[str] = []
        names = self.names()
        for flag, parameter in zip(self.flags, self.parameters(), strict=False):
            unit = UNITS.get(unit_of(flag.field))
            kind = type_text(parameter.annotation)
            lines.append(f"{flag.field} : {kind}{f', in {unit}' if unit else ''}")
            words = in_python(flag.help, names)
            if default := in_python(_default_text(flag, parameter.default), names):
                words += f" Default: {default}."
            lines.append(_indented(words))
        for one, many in self.aliases().items():
            lines += [one, f"    The same as {many}."]
        return "\n".join(lines)

    def _kind(self, flag: Flag) -> Any:
        kind = _python_type(self.model.model_fields[flag.field].annotation)
        if flag.field == "unlisted":
            kind |= str
        return _one_or_several(kind) if flag.field in self.several else kind

    def _default(self, flag: Flag) -> Any:
        return _plain(self.model.model_fields[flag.field].default)


def signed[R](
    signature: Signature,
    *,
    returns: str,
    fails: str,
    wrong: str = "An input is wrong.",
    out: str = "A folder for the command's files.",
    **parameters: str,
) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Give a method that ends with ``**inputs`` its real signature, and its docstring, which says
    what it does, the sections on the rest.

    ``returns`` says what it returns, ``fails`` and ``wrong`` when it raises ComputationError and
    InputError, ``out`` and ``parameters`` what its own parameters are.
    """
    own = {"out": f"{out} Default: none.", **parameters}

    def sign(function: Callable[..., R]) -> Callable[..., R]:
        there = inspect.signature(function, eval_str=True)
        *before, _ = there.parameters.values()
        # keywords without a default cannot be among these
        function.__signature__ = there.replace(parameters=[*before, *signature.parameters()])  # type: ignore[attr-defined]
        taken = sorted(own, key=list(there.parameters).index)
        sections = {
            "Parameters": "\n".join(
                f"{name} : {type_text(there.parameters[name].annotation)}\n{_indented(own[name])}"
                for name in taken
            ),
            "Other Parameters": signature.described(),
            "Returns": f"{type_text(there.return_annotation)}\n{_indented(returns)}",
            "Raises": f"InputError\n{_indented(wrong)}\nComputationError\n{_indented(fails)}",
        }
        parts = (f"{name}\n{'-' * len(name)}\n{text}" for name, text in sections.items())
        function.__doc__ = "\n\n".join([inspect.getdoc(function) or "", *parts])
        return function

    return sign


def _indented(text: str) -> str:
    return fill(text, 92, initial_indent="    ", subsequent_indent="    ")


def type_text(kind: Any) -> str:
    """A type as Python writes it."""
    if kind in (None, NoneType):
        return "None"
    if kind is Any:
        return "Any"
    if get_origin(kind) in (Union, UnionType):
        return " | ".join(map(type_text, get_args(kind)))
    if get_origin(kind) is Literal:
        return f"Literal[{', '.join(map(repr, get_args(kind)))}]"
    if get_args(kind):
        inner = ", ".join("..." if each is ... else type_text(each) for each in get_args(kind))
        return f"{get_origin(kind).__name__}[{inner}]"
    return str(kind.__name__)


def in_python(text: str, own: Mapping[str, str] = {}) -> str:
    """A help text with the names of inputs in place of those of options, first those that a
    function has of its ``own``."""
    names = {**FIELDS, **own}
    return re.sub(
        r"(?<![\w/.-])--[a-z][a-z0-9-]*", lambda found: names.get(found[0], found[0]), text
    )


def _python_type(kind: Any) -> Any:
    """What a caller gives for a field of this type."""
    if get_origin(kind) is Annotated:
        return _python_type(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        return reduce(or_, map(_python_type, get_args(kind)))
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        if inner[-1] is not ...:
            return GenericAlias(tuple, tuple(map(_python_type, inner)))
        item = _python_type(inner[0])
        some = GenericAlias(Iterable, (item,))
        return some if inner[0] is EffectInput else _one_or_several(item)
    if kind is EffectInput:
        return str | Effect
    if kind is MotionInput:
        return str
    if isinstance(kind, type) and issubclass(kind, GivenFile):
        return str | Path
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return Literal[tuple(map(str, kind))]
    return kind


def _one_or_several(kind: Any) -> Any:
    """One of a kind, or several."""
    if get_origin(kind) in (Union, UnionType) and NoneType in get_args(kind):
        kind = reduce(or_, (each for each in get_args(kind) if each is not NoneType))
        return kind | GenericAlias(Iterable, (kind,)) | None
    return kind | GenericAlias(Iterable, (kind,))


def _plain(value: Any) -> Any:
    """A default as a caller would write it."""
    if isinstance(value, StrEnum):
        return str(value)
    return tuple(map(_plain, value)) if isinstance(value, tuple) else value


def _default_text(flag: Flag, default: Any) -> str:
    """The default as a docstring has it; that of a tuple or None only where help says it."""
    if flag.shown is not None or default is None:
        return flag.shown or ""
    return "" if default == () else f"{default:g}" if isinstance(default, float) else str(default)


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=default, annotation=annotation)
