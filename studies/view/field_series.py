"""The fields that a solid's run wrote, as arrays.

Reads what `bristle.solver.paraview.FieldWriter` writes, in one piece whatever the number of ranks
that wrote it.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import adios2
import numpy as np
from numpy.typing import NDArray

from ...solver.arrays import Array
from ...solver.errors import InputError
from ...solver.paraview import FRAMES_FILE, GROUND_FILE, Phase
from ..running.files import read_csv


class FieldSeries(AbstractContextManager):
    """A series of fields on one mesh, opened from its ``.bp``; a context manager.

    ``nodes_m`` (n, 3), ``cells`` (m, nodes per cell) in VTK's order and of VTK's ``cell_type``,
    ``times_s`` (frames,), ``phases`` as long, or empty where the folder does not tell them. A node
    that several ranks share is there once.
    """

    def __init__(self, path: Path) -> None:
        """Raises InputError where there is no series at ``path`` or it has no frame."""
        if not path.is_dir():
            raise InputError(f"{path}: there are no fields here")
        self.path = path
        try:
            self._file = adios2.FileReader(str(path))
            steps = range(self._file.num_steps())
            self.times_s: Array = np.array([self._number("step", step) for step in steps])
            if not len(self.times_s):
                raise ValueError("no frame is complete")
            self.cell_type = int(self._number("types", 0))
            self._read_mesh()
        except (RuntimeError, ValueError, KeyError, IndexError, AttributeError) as error:
            raise InputError(f"{path}: the fields cannot be read: {error}") from error
        self.phases = _phases(path.parent / FRAMES_FILE)[: len(self.times_s)]

    def _read_mesh(self) -> None:
        cells, nodes = self._blocks("connectivity", 0), self._blocks("geometry", 0)
        sizes = [len(block) for block in nodes.values()]
        number = self._node_numbers(sizes)
        _, self._first, compact = np.unique(number, return_index=True, return_inverse=True)
        self.nodes_m: Array = self._merged("geometry", 0)
        offset = dict(zip(nodes, np.cumsum([0, *sizes]), strict=False))
        # VTK's rows begin with the number of nodes that follow
        local = [block[:, 1:] + offset[rank] for rank, block in cells.items()]
        self.cells: NDArray[np.int64] = compact.ravel()[np.concatenate(local)]

    def _node_numbers(self, sizes: list[int]) -> NDArray[np.int64]:
        """A number for each node of each rank's block, the same for nodes that are one.

        Where a rank has no node at all, the numbers in the file are nought for every rank: then
        each block keeps its own.
        """
        written = self._blocks("vtkOriginalPointIds", 0).values()
        numbers = np.concatenate([block.ravel() for block in written])
        if len(numbers) == sum(sizes) and len(np.unique(numbers)) >= max(sizes):
            return numbers
        return np.arange(sum(sizes))

    def read(self, name: str, frame: int) -> Array:
        """A field at a frame: (n,) or (n, components). Raises InputError where it is not there."""
        if name not in self._file.available_variables():
            raise InputError(f"{self.path}: there is no field {name}")
        values = self._merged(name, frame)
        return values[:, 0] if values.shape[1] == 1 else values

    def ground_normal(self) -> Array:
        """The unit normal (3,) of the ground. Raises InputError where the folder does not tell."""
        path = self.path.parent / GROUND_FILE
        if not path.is_file():
            raise InputError(f"{path.parent}: no {GROUND_FILE} here: drop the bristle again")
        try:
            corners = np.array(path.read_text().split("double")[1].split()[:9], float)
            first, second, third = corners.reshape(3, 3)
        except (OSError, IndexError, ValueError) as error:
            raise InputError(f"{path}: not a square of ground") from error
        normal = np.cross(second - first, third - second)
        return normal / np.linalg.norm(normal)

    def _merged(self, name: str, frame: int) -> Array:
        return np.concatenate(list(self._blocks(name, frame).values()))[self._first]

    def _blocks(self, name: str, frame: int) -> dict[int, NDArray[Any]]:
        """What each rank wrote; adios2 cannot read the empty part of a rank that had nothing."""
        parts = self._file.engine.blocks_info(name, frame)
        return {
            rank: self._file.read(name, step_selection=[frame, 1], block_id=rank)
            for rank, part in enumerate(parts)
            if "0" not in part["Count"].split(",")
        }

    def _number(self, name: str, frame: int) -> Any:
        return np.ravel(self._file.read(name, step_selection=[frame, 1]))[0]

    def close(self) -> None:
        """Close the file; what was read stays."""
        self._file.close()

    def __exit__(self, *raised: object) -> None:
        self.close()


def _phases(path: Path) -> list[Phase]:
    try:
        return [Phase(row["phase"]) for row in read_csv(path)]
    except (OSError, KeyError, ValueError):
        return []
