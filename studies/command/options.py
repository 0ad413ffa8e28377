"""Options of a typer command from a table of flags."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import click
import typer

from ..inputs.fields import OUTPUT
from ..inputs.flags import Flag

Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="TOML file with these options as keys, or the JSON of a result, to repeat it. "
        "Flags win over it.",
        show_default=False,
        rich_help_panel=OUTPUT,
    ),
]
Resume = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Keep what is finished in --out, and do only what is missing.",
        rich_help_panel=OUTPUT,
    ),
]
RanksPerCase = Annotated[
    int | None,
    typer.Option(
        "--ranks-per-case",
        min=1,
        metavar="N",
        help="MPI ranks that share one solid, while the others have other cases. "
        "[default: what should end first]",
        show_default=False,
        rich_help_panel=OUTPUT,
    ),
]
Debug = Annotated[
    bool, typer.Option("--debug", help="Show the traceback of an error.", rich_help_panel=OUTPUT)
]


def out_option(default: str) -> Any:
    """The option ``--out`` with its default folder."""
    return typer.Option(
        "--out",
        metavar="DIR",
        help=f"Folder for the result. [default: {default}]",
        show_default=False,
        rich_help_panel=OUTPUT,
    )


def takes(flags: Iterable[Flag]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command these flags; it gets them as ``given``, a dict by parameter.

    The command's own parameters follow. None stands for a flag that is not on the command line.
    """
    flags = tuple(flags)

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = list(inspect.signature(command, eval_str=True).parameters.values())[1:]

        @wraps(command)
        def wrapped(**values: Any) -> None:
            given = {flag.parameter: values.pop(flag.parameter) for flag in flags}
            command(given, **values)

        options = [_parameter(flag) for flag in flags]
        named = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in own]
        wrapped.__signature__ = inspect.Signature([*options, *named])  # type: ignore[attr-defined]
        wrapped.__annotations__ = {each.name: each.annotation for each in [*options, *named]}
        del wrapped.__wrapped__
        return wrapped

    return decorate


def _parameter(flag: Flag) -> inspect.Parameter:
    names = flag.spellings
    if flag.kind is bool and flag.default:
        names = (f"{flag.option}/--no-{flag.name}",)
    declared, default = flag.declared, flag.default_text()
    option = typer.Option(
        *names,
        help=declared.help + (f" [default: {default}]" if default else ""),
        metavar=declared.metavar,
        show_default=False,
        rich_help_panel=declared.group,
        click_type=_click_type(flag),
    )
    return inspect.Parameter(
        flag.parameter,
        inspect.Parameter.KEYWORD_ONLY,
        default=None,
        annotation=Annotated[_annotation(flag), option],
    )


def _click_type(flag: Flag) -> click.ParamType | None:
    if isinstance(flag.kind, type) and issubclass(flag.kind, StrEnum):
        return click.Choice([member.value for member in flag.kind])
    return None


def _annotation(flag: Flag) -> Any:
    if flag.kind is list:
        return list[str] | None
    if isinstance(flag.kind, tuple):
        return tuple.__class_getitem__(flag.kind) | None
    if isinstance(flag.kind, type) and issubclass(flag.kind, StrEnum):
        return str | None
    return flag.kind | None
