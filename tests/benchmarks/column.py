"""How a field of a record is headed in its tables."""

from dataclasses import field
from typing import Any


def column(head: str, unit: str = "", digits: int = 3) -> Any:
    """A field of a record: how its table is headed, its unit, and the digits that are shown."""
    return field(metadata={"column": (head, unit, digits)})
