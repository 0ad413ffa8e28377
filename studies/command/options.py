"""Commands as click's objects, with typer's help: their options come from tables of flags."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
from pydantic import BaseModel
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from ..inputs.fields import OUTPUT
from ..inputs.flags import Flag
from ..inputs.sources import inputs_of

A_PATH = click.Path(path_type=Path)


def _folder(name: str) -> Path:
    if not name:
        raise click.BadParameter("is empty; a dot is the current folder")
    return Path(name)


def _number(context: click.Context, option: click.Parameter, value: float) -> float:
    if math.isnan(value):  # inside any range for click
        raise click.BadParameter("nan is no number", param_hint=option.opts[0])
    return value


def option(*names: str, panel: str | None = None, **how: Any) -> TyperOption:
    """An option under ``panel`` of the help; ``how`` is that of click's."""
    return TyperOption(param_decls=list(names), rich_help_panel=panel, **how)


def argument(
    name: str, metavar: str, help: str, type: Any = A_PATH, default: Any = None, nargs: int = 1
) -> TyperArgument:
    """An argument, which must be there where it has no ``default``."""
    return TyperArgument(
        param_decls=[name],
        metavar=metavar,
        help=help,
        type=type,
        default=default,
        required=default is None,
        show_default=default is not None,
        nargs=nargs,
    )


of_files = partial(option, panel=OUTPUT)
a_folder = partial(option, "--out", metavar="DIR", type=_folder)
CONFIG = of_files(
    "--config",
    type=A_PATH,
    metavar="FILE",
    help="TOML file with these options as keys, or the JSON of a result, to repeat it. "
    "Flags win over it.",
)
RESUME = of_files(
    "--resume",
    is_flag=True,
    default=False,
    help="Keep what is finished in --out, and do only what is missing.",
)
KEEP = of_files(
    "--keep",
    type=click.FloatRange(min=0.0),
    default=60.0,
    callback=_number,
    metavar="SECONDS",
    help="Seconds from one checkpoint to the next. --resume goes on from the last one.",
    show_default=True,
)
RANKS_PER_CASE = of_files(
    "--ranks-per-case",
    type=click.IntRange(min=1),
    metavar="N",
    help="MPI ranks that share one solid, while the others have other cases. "
    "[default: the fastest, as estimated]",
)
DEBUG = of_files("--debug", is_flag=True, default=False, help="Show the traceback of an error.")


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
    app: TyperGroup,
    *parameters: click.Parameter,
    flags: Iterable[Flag] = (),
    ignored: Iterable[Flag] = (),
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Have ``app`` run a function as the command of its name, with its ``parameters`` by keyword.

    Its docstring is the help. Where there are flags it gets them, and ``--config``, as its first
    argument, a `Given`. Unless one of the parameters is ``out``, it gets the option ``--out``, with
    a folder in results/. Each has ``--debug``, which `ending` reads.
    """
    flags, ignored = tuple(flags), tuple(ignored)

    def add(command: Callable[..., None]) -> Callable[..., None]:
        name = command.__name__.replace("_", "-")

        def run(debug: bool, **values: Any) -> None:
            if not flags:
                return command(**values)
            by_flag = {flag.parameter: values.pop(flag.parameter) for flag in flags}
            return command(Given(by_flag, flags, values.pop("config"), ignored), **values)

        every: list[click.Parameter] = [*map(_of_flag, flags), CONFIG] if flags else []
        if all(each.name != "out" for each in parameters):
            words = f"Folder for the result. [default: results/{name}]"
            every.append(a_folder(panel=OUTPUT, help=words, default=Path(f"results/{name}")))
        # paragraphs stay apart only behind a \b: typer joins the others
        text = (inspect.getdoc(command) or "").replace("\n\n", "\n\n\b\n")
        params = [*every, *parameters, DEBUG]
        app.add_command(
            TyperCommand(name, callback=run, params=params, help=text, rich_markup_mode="markdown")
        )
        return command

    return add


def _of_flag(flag: Flag) -> TyperOption:
    negative = flag.kind is bool and flag.default
    names = (f"{flag.option}/--no-{flag.name}",) if negative else flag.spellings
    default = flag.default_text()
    kind = {bool: None, list: str}.get(flag.kind, flag.kind)
    return option(
        flag.parameter,
        *names,
        help=flag.help + (f" [default: {default}]" if default else ""),
        type=click.Choice(list(map(str, kind))) if flag.is_choice else kind,
        is_flag=flag.kind is bool or None,
        multiple=flag.kind is list,
        metavar=flag.metavar,
        panel=flag.group,
    )
