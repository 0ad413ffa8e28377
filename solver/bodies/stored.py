"""Modal bodies as plain arrays, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from ..arrays import Array
from .axis import Axis
from .base import ContactPoints, dense_of
from .modal import ModalBody

PARTS: dict[str, type] = {"contact": ContactPoints, "axis": Axis}
NOT_STORED = ("comm",)


def to_arrays(bodies: Sequence[ModalBody]) -> dict[str, Array]:
    """Every number of the ``bodies`` by its name; parts that one does not have are left out."""
    return {f"{i}.{name}": value for i, body in enumerate(bodies) for name, value in _numbers(body)}


def from_arrays(arrays: Mapping[str, Array]) -> tuple[ModalBody, ...]:
    """The bodies that `to_arrays` took apart, to the bit."""
    bodies: dict[int, dict[str, Array]] = {}
    for name, value in arrays.items():
        number, _, rest = name.partition(".")
        bodies.setdefault(int(number), {})[rest] = value
    return tuple(_body(bodies[i]) for i in sorted(bodies))


def _numbers(body: ModalBody) -> Iterator[tuple[str, Array]]:
    for each in fields(body):
        value = getattr(body, each.name)
        if each.name not in PARTS:
            yield each.name, np.asarray(value)
        elif value is not None:
            for inner in fields(value):
                if inner.name not in NOT_STORED:
                    part = getattr(value, inner.name)
                    yield f"{each.name}.{inner.name}", dense_of(part)


def _body(arrays: Mapping[str, Array]) -> ModalBody:
    parts: dict[str, dict[str, Any]] = {}
    whole: dict[str, Any] = {}
    for name, value in arrays.items():
        part, dot, inner = name.partition(".")
        plain = value.item() if value.ndim == 0 else value
        if dot:
            parts.setdefault(part, {})[inner] = plain
        else:
            whole[name] = plain
    made = {name: PARTS[name](**values) for name, values in parts.items()}
    return ModalBody(**whole, **made)
