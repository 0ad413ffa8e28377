"""Commands of typer whose options come from tables of flags."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any

import click
import typer
from pydantic import BaseModel

from ..inputs.fields import OUTPUT
from ..inputs.flags import Flag
from ..inputs.sources import inputs_of

optional = partial(typer.Option, show_default=False)
of_files = partial(optional, rich_help_panel=OUTPUT)


def _folder(name: str) -> Path:
    if not name:
        raise typer.BadParameter("is empty; a dot is the current folder")
    return Path(name)


a_folder = partial(optional, metavar="DIR", parser=_folder)
Config = Annotated[
    Path | None,
    of_files(
        "--config",
        metavar="FILE",
        help="TOML file with these options as keys, or the JSON of a result, to repeat it. "
        "Flags win over it.",
    ),
]
Resume = Annotated[
    bool, of_files("--resume", help="Keep what is finished in --out, and do only what is missing.")
]
RanksPerCase = Annotated[
    int | None,
    of_files(
        "--ranks-per-case",
        min=1,
        metavar="N",
        help="MPI ranks that share one solid, while the others have other cases. "
        "[default: the fastest, as estimated]",
    ),
]
Debug = Annotated[bool, of_files("--debug", help="Show the traceback of an error.")]


@dataclass(frozen=True)
class Given:
    """What stands on the command line: ``values`` of ``flags`` by parameter, and a configuration
    file, in which keys of ``ignored`` flags may stand too."""

    values: dict[str, Any]
    flags: tuple[Flag, ...]
    config: Path | None
    ignored: tuple[Flag, ...]

    def inputs[Checked: BaseModel](self, kind: type[Checked]) -> Checked:
        """Inputs from the flags over the file over the defaults; InputError."""
        return inputs_of(kind, self.values, self.flags, self.config, self.ignored)


def add_command(
    app: typer.Typer, flags: Iterable[Flag] = (), ignored: Iterable[Flag] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Have ``app`` run a function as the command of its name.

    Its docstring is the help. Where there are flags it gets them, and ``--config``, as its first
    argument, a `Given`; its other parameters follow. One called ``out`` without a default gets the
    option ``--out``, with a folder in results/. Each has ``--debug``, which `ending` reads.
    """
    flags, ignored = tuple(flags), tuple(ignored)

    def add(command: Callable[..., None]) -> Callable[..., None]:
        name = command.__name__.replace("_", "-")
        own = list(inspect.signature(command, eval_str=True).parameters.values())
        if flags:
            own[0] = _keyword("config", Config, None)
        missing = ("out", inspect.Parameter.empty)
        own = [
            _out(f"results/{name}") if (each.name, each.default) == missing else each
            for each in own
        ]

        @wraps(command)
        def run(debug: bool, **values: Any) -> None:
            by_flag = {flag.parameter: values.pop(flag.parameter) for flag in flags}
            for name, value in values.items():
                if isinstance(value, float) and math.isnan(value):  # inside any range for click
                    option = f"--{name.replace('_', '-')}"
                    raise typer.BadParameter("nan is no number", param_hint=option)
            if flags:
                command(Given(by_flag, flags, values.pop("config"), ignored), **values)
            else:
                command(**values)

        parameters = [*map(_parameter, flags), *own, _keyword("debug", Debug, False)]
        named = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in parameters]
        run.__signature__ = inspect.Signature(named)  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in named}
        del run.__wrapped__
        # paragraphs stay apart only behind a \b: typer joins the others
        text = (inspect.getdoc(command) or "").replace("\n\n", "\n\n\b\n")
        app.command(name, help=text)(run)
        return command

    return add


def _out(default: str) -> inspect.Parameter:
    words = f"Folder for the result. [default: {default}]"
    option = a_folder("--out", help=words, rich_help_panel=OUTPUT)
    return _keyword("out", Annotated[Path, option], Path(default))


def _keyword(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(name, kind, default=default, annotation=annotation)


def _parameter(flag: Flag) -> inspect.Parameter:
    names = flag.spellings
    if flag.kind is bool and flag.default:
        names = (f"{flag.option}/--no-{flag.name}",)
    default = flag.default_text()
    option = optional(
        *names,
        help=flag.help + (f" [default: {default}]" if default else ""),
        metavar=flag.metavar,
        rich_help_panel=flag.group,
        click_type=click.Choice(list(map(str, flag.kind))) if flag.is_choice else None,
    )
    return _keyword(flag.parameter, Annotated[_annotation(flag), option], None)


def _annotation(flag: Flag) -> Any:
    if flag.kind is list:
        return list[str] | None
    if isinstance(flag.kind, tuple):
        return tuple.__class_getitem__(flag.kind) | None
    return str | None if flag.is_choice else flag.kind | None
