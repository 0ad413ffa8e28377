"""How does a modal body become plain arrays and back?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from .axis import Axis
from .base import Array, ContactPoints, dense_of
from .modal import Defect, ModalBody

PARTS: dict[str, type] = {"contact": ContactPoints, "defect": Defect, "axis": Axis}
NOT_STORED = ("comm",)


def to_arrays(body: ModalBody) -> dict[str, Array]:
    """Every number of ``body`` by its name; parts that it does not have are left out."""
    arrays: dict[str, Any] = {}
    for each in fields(body):
        value = getattr(body, each.name)
        if each.name not in PARTS:
            arrays[each.name] = np.asarray(value)
        elif value is not None:
            for inner in fields(value):
                if inner.name not in NOT_STORED:
                    part = getattr(value, inner.name)
                    arrays[f"{each.name}.{inner.name}"] = dense_of(part)
    return arrays


def from_arrays(arrays: Mapping[str, Array]) -> ModalBody:
    """The body that `to_arrays` took apart, to the bit."""
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
