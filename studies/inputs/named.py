"""What options give by name: an effect with its parameters, files by path and digest."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import Field

from ...solver.errors import InputError
from .choices import Motion
from .flags import Fields
from .texts import hints

if TYPE_CHECKING:
    from ...meshes.own import OwnMesh
    from ...solver.effects.base import Effect

# What a mesh file says itself.
REPLACED = (
    *("length_m", "width_m", "thickness_m", "diameter_m"),
    *("cells", "grading", "geometry_order"),
)


class EffectInput(Fields):
    """An effect by name, with all its parameters in SI (angles in degrees)."""

    name: str
    parameters: dict[str, float] = Field(default_factory=dict)

    def effect(self) -> Effect:
        """The effect itself; ValueError where it or a parameter is unknown or out of bounds."""
        kind = _kind(self.name)
        names = [field.name for field in fields(kind)]
        for name in self.parameters:
            if name not in names:
                near = hints(name, names) or [f"it has {', '.join(names)}"]
                raise ValueError(f"{self.name} has no parameter '{name}'; {near[0]}")
        try:
            return kind(**self.parameters)
        except InputError as error:
            raise ValueError(str(error)) from None

    @classmethod
    def of(cls, effect: Effect) -> EffectInput:
        """The same in words."""
        values = {field.name: float(getattr(effect, field.name)) for field in fields(effect)}
        return cls(name=effect.name, parameters=values)


def parse_effect(text: str) -> EffectInput:
    """Read ``NAME:param=value,…``; ValueError says what is wrong with it."""
    name, colon, rest = text.partition(":")
    parameters: dict[str, float] = {}
    for part in rest.split(",") if colon else ():
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not key or not equals:
            raise ValueError(f"must be NAME:param=value,…, not '{text}'")
        if key in parameters:
            raise ValueError(f"gives '{key}' twice in '{text}'")
        try:
            parameters[key] = float(value)
        except ValueError:
            raise ValueError(f"must give '{key}' a number, not '{value}'") from None
        if not math.isfinite(parameters[key]):
            raise ValueError(f"must give '{key}' a finite number, not '{value}'")
    return EffectInput(name=_kind(name.strip()).name, parameters=parameters)


def _kind(name: str) -> type[Effect]:
    """The effect of this name; ValueError with a near one where there is none."""
    from ...solver.effects.library import EFFECTS
    from ...solver.effects.outside import load_installed

    if name not in EFFECTS:
        load_installed()
    if name in EFFECTS:
        return EFFECTS[name]
    near = hints(name, EFFECTS) or [f"there are {', '.join(EFFECTS)}"]
    raise ValueError(f"names an unknown effect '{name}'; {near[0]}")


def read_effects(value: Any) -> Any:
    """Effects from texts, from instances or from what a result holds; ValueError where one is
    malformed."""
    if not isinstance(value, list | tuple):
        raise ValueError(f"must be a list of NAME:param=value,…, not {value!r}")
    found: list[EffectInput] = []
    for item in value:
        given = _effect_input(item)
        if any(given.name == other.name for other in found):
            raise ValueError(f"names {given.name} twice")
        found.append(EffectInput.of(given.effect()))
    return tuple(found)


def _effect_input(item: Any) -> EffectInput:
    """One item of `read_effects`."""
    if isinstance(item, str):
        return parse_effect(item)
    if isinstance(item, EffectInput | dict):
        return EffectInput.model_validate(item)
    from ...solver.effects.base import Effect
    from ...solver.effects.outside import taken_in

    if not isinstance(item, Effect):
        raise ValueError(f"must be NAME:param=value,… or an Effect, not {item!r}")
    try:
        return EffectInput.of(taken_in(item))
    except InputError as error:
        raise ValueError(str(error)) from None


class GivenFile(Fields):
    """A file: where it is, and the SHA-256 of what was in it when the run was asked for."""

    path: str
    sha256: str
    option: ClassVar[str] = "--surface"

    def __str__(self) -> str:
        """As the option has it."""
        return self.path

    @classmethod
    def of(cls, value: Any, digest: Callable[[Path], str] | None = None) -> Any:
        """That of a path, or of an earlier run's path and digest, checked against the file; what
        is neither stays as it is.

        Raises ValueError where the file cannot be read, or has changed since.
        """
        if isinstance(value, str | Path):
            value = {"path": str(Path(value).resolve())}
        if not isinstance(value, dict) or not isinstance(value.get("path"), str):
            return value
        now = (digest or _sha256)(Path(value["path"]))
        before = value.get("sha256", now)
        if before != now:
            raise ValueError(
                f"{value['path']} has changed since that run: its SHA-256 was "
                f"{str(before)[:12]}…, and is {now[:12]}…; name it with {cls.option} to take it as "
                "it is"
            )
        return cls(**{**value, "sha256": now})


class MotionFile(GivenFile):
    """The path of a hub."""

    option: ClassVar[str] = "--motion"


class MotionInput(Fields):
    """How a hub moves: ``speed_m_s`` of one that slides, ``rpm`` of one that rotates, or its path
    in a ``file``."""

    kind: Motion
    speed_m_s: float | None = None
    rpm: float | None = None
    file: MotionFile | None = None

    def __str__(self) -> str:
        """As the option has it."""
        if self.file is not None:
            return f"{self.kind}:{self.file.path}"
        given = {"speed": self.speed_m_s, "rpm": self.rpm}
        said = (f":{name}={value:g}" for name, value in given.items() if value is not None)
        return f"{self.kind}{next(said, '')}"


def read_motion(value: Any) -> Any:
    """A `MotionInput` of ``press``, ``slide:speed=…``, ``rotate:rpm=…`` or ``file:FILE.csv``, or of
    what a result holds; ValueError where it is malformed, or the file has changed since."""
    if isinstance(value, dict):
        file = value.get("file")
        kept = {"file": MotionFile.of(file)} if isinstance(file, dict) else {}
        return MotionInput.model_validate({**value, **kept})
    if not isinstance(value, str):
        return value
    name, _, rest = value.strip().partition(":")
    key, _, text = (part.strip() for part in rest.partition("="))
    if name == Motion.FILE and rest:
        return MotionInput(kind=Motion.FILE, file=MotionFile.of(rest))
    if name == Motion.PRESS and not rest:
        return MotionInput(kind=Motion.PRESS)
    keys = {Motion.SLIDE: ("speed", "speed_m_s"), Motion.ROTATE: ("rpm", "rpm")}
    for kind, (said, field) in keys.items():
        if name == kind and key == said:
            return MotionInput.model_validate({"kind": kind, field: _speed(said, text)})
    raise ValueError(
        f"must be press, slide:speed=M/S, rotate:rpm=RPM or file:FILE.csv, not '{value}'"
    )


def _speed(name: str, text: str) -> float:
    try:
        speed = float(text)
    except ValueError:
        speed = math.nan
    if not math.isfinite(speed) or speed == 0.0:
        raise ValueError(f"must give '{name}' a finite number other than 0, not '{text}'")
    return speed


def _sha256(path: str | Path) -> str:
    """Of what is in a file; ValueError where it cannot be read."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from None


class MeshFile(GivenFile):
    """A bristle's mesh."""

    option: ClassVar[str] = "--mesh"

    def read(self) -> OwnMesh:
        """What is in it; MeshError where that is no bristle."""
        from ...meshes.own import own_mesh

        return own_mesh(Path(self.path), self.sha256)


class PluginFile(GivenFile):
    """Python with effects or kinds of data of the user's own."""

    option: ClassVar[str] = "--plugin"


def read_mesh_file(value: Any) -> Any:
    """A `MeshFile` (`GivenFile.of`); ValueError also where the file is no mesh of a bristle."""
    from ...meshes.check import MeshError
    from ...meshes.own import digest

    try:
        file = MeshFile.of(value, digest)
        if file is not value:
            file.read()
    except MeshError as error:
        raise ValueError(str(error)) from error
    return file


def read_plugins(value: Any) -> Any:
    """`PluginFile`s (`GivenFile.of`), whose effects are taken in; ValueError also where one is no
    Python, or an effect is refused."""
    if isinstance(value, str):
        value = [value]
    if not isinstance(value, list | tuple):
        raise ValueError(f"must be a list of Python files, not {value!r}")
    return tuple(_read_plugin(item) for item in value)


def _read_plugin(value: Any) -> Any:
    file = PluginFile.of(value)
    if file is not value:
        from .kinds import load

        load(Path(file.path), Path(file.path).read_bytes())
    return file


def digest_of(path: Path) -> str | None:
    """SHA-256 of what is in a file, None where it cannot be read."""
    try:
        return _sha256(path)
    except ValueError:
        return None
