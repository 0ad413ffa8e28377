"""Merging of inputs: flags over a file over defaults.

Also how errors name an input's place, and the command line that repeats a result.
"""

from __future__ import annotations

import logging
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from ...solver.errors import InputError
from ...solver.materials import MATERIALS, MaterialName
from .brush_fields import BRUSH_FLAGS
from .choices import Motion
from .fields import DROP_FLAGS, LIST_FLAGS
from .flags import Flag
from .named import REPLACED, digest_of
from .study_fields import CALIBRATE_FLAGS, LOOP_FLAGS, OWN_FLAGS, SYNTH_FLAGS, TRACK_FLAGS
from .texts import hints, line_of, parse_json, parse_toml, quoted, read_text

LOG = logging.getLogger("bristle")
EVERY_FLAG = (
    *BRUSH_FLAGS,
    *(*SYNTH_FLAGS, *CALIBRATE_FLAGS, *LOOP_FLAGS, *TRACK_FLAGS),
    *(*OWN_FLAGS, *DROP_FLAGS, *LIST_FLAGS),
)
OPTIONS = {flag.field: flag.option for flag in EVERY_FLAG}

# What a value excludes, and what an earlier run resolved from it.
EXCLUDED = {
    "diameter_m": ("width_m", "thickness_m"),
    "width_m": ("diameter_m",),
    "thickness_m": ("diameter_m",),
    "contact": ("theta", "gamma0"),
    "scheme": ("rho_inf",),
    "mesh": REPLACED,
    "flat": ("rms_height_m", "correlation_length_m", "surface"),
    "surface": ("rms_height_m", "correlation_length_m", "flat"),
}
RESOLVED = {
    "diameter_m": ("geometry_order",),
    "width_m": ("geometry_order",),
    "thickness_m": ("geometry_order",),
    "poisson": ("kt_ratio",),
    "material": (
        *("youngs_Pa", "poisson", "density_kg_m3", "beta_s", "kt_ratio", "yield_strength_Pa"),
    ),
    "friction": ("friction_static", "friction_between"),
    "motion": ("penetration_m", "until_s", "every_s"),
    "until_s": ("every_s",),
}
# Fields that name files. In a TOML file their paths count from its folder.
FILES = ("mesh", "plugins", "surface")
OF_FILE = f"{Motion.FILE}:"
# Inputs that earlier versions had, by the one value with which a drop is the same without them.
RETIRED = {"march": False}
# Where the material has a name, its damping follows from these.
DAMPING = ("length_m", "mesh", "youngs_Pa", "density_kg_m3")


def resolved_from(names: Iterable[str], *, material: bool) -> set[str]:
    """Fields that were resolved from those of these names; ``material`` says that it has a name."""
    found = {below for name in names for below in RESOLVED.get(name, ())}
    return found | ({"beta_s"} if material and set(names) & set(DAMPING) else set())


@dataclass
class Source:
    """Values by field of the inputs, and how each is to be named to the user.

    ``resolved`` are those of a result, which holds what followed from others as if it were given.
    """

    values: dict[str, Any] = field(default_factory=dict)
    origins: dict[str, str] = field(default_factory=dict)
    resolved: bool = False

    def over(self, other: Source) -> Source:
        """These values over those of ``other``, without what they exclude there or followed from
        what they replace."""
        gone = {below for above in self.values for below in EXCLUDED.get(above, ())}
        if other.resolved:
            material = other.values.get("material") is not None
            of_mesh = other.values.get("mesh") is not None  # whose length is not among the values
            followed = material_damping_s(other.values, other.values.get("length_m"))
            own = of_mesh or followed == other.values.get("beta_s")
            gone |= resolved_from(self.values, material=material and own)
        values = {key: value for key, value in other.values.items() if key not in gone}
        return Source(values | self.values, other.origins | self.origins)


def material_damping_s(values: Mapping[str, Any], length_m: Any) -> float | None:
    """β of the material that ``values`` name, of a bristle of this length; None where none is
    named, or what it follows from is no number."""
    name = values.get("material")
    needed = [length_m, values.get("youngs_Pa"), values.get("density_kg_m3")]
    numbers = [float(x) for x in needed if isinstance(x, float | int) and x > 0.0]
    if name not in tuple(MaterialName) or len(numbers) < len(needed):
        return None
    return MATERIALS[MaterialName(name)].damping_s(*numbers)


def flag_source(given: Mapping[str, Any], flags: Iterable[Flag]) -> Source:
    """What stands on the command line: ``given`` by parameter, None where it does not."""
    found = Source()
    for flag in flags:
        value = given.get(flag.parameter)
        if value is None or (flag.kind is list and not value):
            continue
        found.values[flag.field] = value
        found.origins[flag.field] = flag.option
    return found


def checked[Checked: BaseModel](
    kind: type[Checked], values: Mapping[str, Any], origins: Mapping[str, str] = {}
) -> Checked:
    """A ``kind`` of these values; InputError names where the first wrong one came from."""
    try:
        return kind.model_validate(dict(values), context={"origins": origins})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name, message = _explain(first, kind)
        origin = origins.get(name, OPTIONS.get(name, name))
        raise InputError(f"{origin}: {message}") from error


def _explain(error: Any, kind: type[BaseModel]) -> tuple[str, str]:
    """The field and what is wrong with it, in the user's words."""
    if error["type"] == "bristle":
        return error["ctx"]["field"], error["ctx"]["message"]
    name = str(error["loc"][0]) if error["loc"] else "inputs"
    if error["type"] == "extra_forbidden":
        flag = f"--{name.replace('_', '-')}"
        same = [each for each in kind.model_fields if OPTIONS.get(each) == flag]
        near = [f"did you mean {each}?" for each in same] or hints(name, kind.model_fields)
        return name, "; ".join(["is no known input", *near])
    if error["type"] == "too_short":
        return name, "is an empty list"
    if error["type"] == "value_error":
        return name, str(error["ctx"]["error"])
    if name == "cells" and error["type"] in ("missing", "too_long", "tuple_type"):
        return name, "must be three whole numbers NX NY NZ"
    message = error["msg"].replace("Input should be", "must be")
    message = message.replace("a valid integer", "a whole number").replace("a valid", "a")
    return name, f"{message}, not {quoted(error['input'])}"


def read_config(path: Path, flags: Iterable[Flag], ignored: Iterable[Flag] = ()) -> Source:
    """A TOML file with the flags' names as keys, or a result of this program to repeat.

    Keys of ``ignored`` flags may be there and are passed over; `FILES` are looked for beside a TOML
    file. Raises InputError, with file and line, where it cannot be read or holds an unknown key.
    """
    try:
        text = read_text(path)
    except InputError as error:
        raise InputError(f"--config {error}") from error
    data = _parse_result(path, text) if path.suffix == ".json" else parse_toml(path, text)
    fields, passed_over = _fields_by_key(flags), _fields_by_key(ignored)
    found = Source(resolved=path.suffix == ".json")
    for key, value in data.items():
        if key in passed_over and key not in fields:
            continue
        place = f"{path}:{line_of(text, key) or 1}: {key}"
        name = fields.get(key)
        if name is None:
            raise InputError("; ".join([f"{place}: unknown key", *hints(key, fields)]))
        if name in found.values:
            raise InputError(f"{place}: given twice, also as {found.origins[name]}")
        if name in FILES and not found.resolved:
            value = _beside(path, value)
        if name == "motion" and str(value).startswith(OF_FILE):
            value = f"{OF_FILE}{_beside(path, value.removeprefix(OF_FILE))}"
        found.values[name], found.origins[name] = value, place
    return found


def _beside(path: Path, value: Any) -> Any:
    """File names in ``value``, relative ones from the folder of the file ``path``."""
    if isinstance(value, list):
        return [_beside(path, each) for each in value]
    return str(path.parent / value) if isinstance(value, str) else value


def _fields_by_key(flags: Iterable[Flag]) -> dict[str, str]:
    """Every spelling of a key, and the field that it sets."""
    found: dict[str, str] = {}
    for flag in flags:
        spelt = (each.removeprefix("--") for each in flag.spellings)
        found |= dict.fromkeys((*spelt, flag.parameter, flag.field), flag.field)
    return found


def _parse_result(path: Path, text: str) -> dict[str, Any]:
    data = parse_json(path, text)
    inputs = data.get("inputs") if isinstance(data, dict) else None
    if not isinstance(inputs, dict):
        raise InputError(f"{path}:1: not a result of this program: it has no inputs")
    return {
        key: value
        for key, value in inputs.items()
        if value is not None and (key not in RETIRED or value != RETIRED[key])
    }


def inputs_of[Checked: BaseModel](
    kind: type[Checked],
    given: Mapping[str, Any],
    flags: Iterable[Flag],
    config: Path | None,
    ignored: Iterable[Flag] = (),
) -> Checked:
    """Inputs from the command line over a configuration file over the defaults; InputError."""
    flags = tuple(flags)
    found = flag_source(given, flags)
    if config is not None:
        read = read_config(config, flags, ignored)
        _check_plugins(read, found.values.get("plugins", ()))
        found = found.over(read)
    return checked(kind, found.values, found.origins)


def _check_plugins(file: Source, named: Iterable[str]) -> None:
    """InputError where a configuration file names a plugin that the command line does not.

    Plugins are code of anybody's, and only the user says what is run. One that lies elsewhere now
    is known by its digest.
    """
    given = {Path(each).resolve(): digest_of(Path(each)) for each in named}
    value = file.values.get("plugins") or []
    for each in value if isinstance(value, list) else [value]:
        entry = each if isinstance(each, dict) else {"path": each}
        path, before = Path(str(entry.get("path"))).resolve(), entry.get("sha256")
        if path in given:
            if before not in (None, given[path]):
                LOG.warning("%s has changed since that run, and is taken as it is now", path)
        elif before is None or before not in given.values():
            raise InputError(
                f"{file.origins['plugins']}: names {path}, whose code is run only if the command "
                f"line names it too: add --plugin {path}"
            )


def command_line(
    name: str, inputs: BaseModel, usual: BaseModel, out: Path, *arguments: object
) -> str:
    """``bristle NAME`` with its arguments, what differs from the ``usual`` inputs, and its
    folder."""
    words: list[object] = [name, *arguments]
    for key, flag in {flag.field: flag for flag in EVERY_FLAG}.items():
        value: Any = getattr(inputs, key, None)
        if key not in type(inputs).model_fields or value in (None, getattr(usual, key)):
            continue
        if isinstance(value, bool):
            words.append(flag.option if value else flag.option.replace("--", "--no-", 1))
        elif flag.kind is list:
            words += [word for each in value for word in (flag.option, each)]
        elif isinstance(value, tuple) and not isinstance(flag.kind, tuple):
            words += [flag.option, ",".join(map(str, value))]
        else:
            words += [flag.option, *(value if isinstance(value, tuple) else (value,))]
    return into(out, *words)


def into(out: Path, *words: object) -> str:
    """``bristle WORDS`` into the folder ``out``, as a shell takes it."""
    return shlex.join(["bristle", *map(str, words), "--out", str(out)])
