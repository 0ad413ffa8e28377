"""How is a slender body's matrix factored? Slice after slice along its axis, read once each way.

Unknowns are ordered by their height, from the far end to the tip. What a slice couples to stands
right after it, so that each slice has one dense panel, and elimination fills nothing else: the
block form of an envelope factor (George and Liu, Computer Solution of Large Sparse Positive
Definite Systems, 1981, Ch. 4). A solve is bound by the reading of the panels. They lie in memory
as they are read, and each column of the inverse of a slice's own triangle, and of what lies below,
is a run of its own: such runs are read at the speed of memory, blocks under BLAS at a third of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dgemm, dsyrk, dtrmm, dtrsm
from scipy.linalg.lapack import dpotrf, dtrtri

from ..arrays import Array
from ..compiled import fast, njit
from ..errors import ComputationError

SAME_LEVEL = 1e-7  # over the body's length
# Numbers per unknown up to which a chain is taken. Against MUMPS a solve is 2.5 times as fast at
# 170 of them, 1.7 times at 510, and equal at 1050, where nested dissection leaves 410.
WIDEST = 600
# Runs start and end at multiples of these, so that vector units leave few remainders.
TRIANGLE, BELOW = 4, 8
# Right-hand sides that share one reading of a panel, BLAS being no faster with more.
TOGETHER = 64
# Up to so many are quicker one by one.
FEW = 3

Index = NDArray[np.int64]
Rows = NDArray[np.integer]
# Compressed rows and a weight: offsets, columns, values, weight, block. A block of 3 says that rows
# and columns are nodes, and that each entry stands for itself times the unit matrix of three
# directions.
Summand = tuple[Rows, Rows, Array, float, int]


@dataclass(frozen=True)
class Layout:
    """How unknowns are ordered and cut into panels.

    ``order`` (n,) are the unknowns in the order of elimination, ``place`` its inverse over all
    columns of the matrix: ``last`` unknowns that are not eliminated come after them, those that are
    left out stand at -1. Panel i has the columns ``starts[i]`` to ``starts[i + 1]`` and rows down
    to ``ends[i]``. ``offsets`` say where panels begin in the factor.
    """

    order: Index
    place: Index
    starts: Index
    ends: Index
    offsets: Index
    last: int

    @property
    def entries(self) -> int:
        """Numbers in the factor."""
        return int(self.offsets[-1])


def lay_out(
    first: Rows, column: Rows, height: Array, inside: Index | None = None, last: Index | None = None
) -> Layout:
    """The layout for a symmetric pattern in compressed rows and unknowns at ``height`` (n,).

    Where a matrix is to be eliminated in part, ``inside`` (n,) are the rows that are, and ``last``
    the columns of unknowns below the lowest of them that stay; other columns are left out.
    """
    rows = np.arange(len(height)) if inside is None else inside
    columns = max(len(first) - 1, int(column.max(initial=-1)) + 1)
    last = np.arange(0) if last is None else last
    n = len(rows)
    by_height = np.argsort(-height, kind="stable")
    order = rows[by_height]
    steps = np.diff(height[by_height]) < -SAME_LEVEL * np.ptp(height)
    levels = np.concatenate([[0], np.cumsum(steps)])
    count = int(levels[-1]) + 1
    level, place = np.full((2, columns), -1)
    level[order], place[order] = levels, np.arange(n)
    level[last], place[last] = count, n + np.arange(len(last))
    reach = np.maximum.accumulate(_reach(first, column, rows, level, count))
    edges = np.concatenate([[0], np.cumsum(np.bincount(levels)), [n + len(last)]])
    # levels that reach equally far are one slice: nothing more is filled, and panels are longer
    heads = np.flatnonzero(np.concatenate([[True], reach[1:] != reach[:-1]]))
    starts, ends = np.append(edges[heads], n), edges[reach[heads] + 1]
    width = np.diff(starts)
    below = _rounded(ends - starts[1:], BELOW)
    sizes = [_triangle(int(w)) + int(w * m) for w, m in zip(width, below, strict=True)]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    return Layout(order, place, starts, ends, offsets, len(last))


def _rounded[Count: (int, Index)](count: Count, step: int) -> Count:
    return -(-count // step) * step


def _triangle(width: int) -> int:
    """Numbers kept of a lower triangle: columns from the multiple of TRIANGLE above them down."""
    return sum(_rounded(width, TRIANGLE) - c // TRIANGLE * TRIANGLE for c in range(width))


@njit
def _reach(first: Rows, column: Rows, rows: Index, level: Index, count: int) -> Index:
    """The last level that each of ``count`` levels couples to."""
    reach = np.arange(count)
    for row in rows:
        here = level[row]
        for k in range(first[row], first[row + 1]):
            reach[here] = max(reach[here], level[column[k]])
    return reach


class ChainFactor:
    """Cholesky factor of a symmetric matrix in the order of ``layout``.

    ``parts`` add up to the matrix. Rows of the layout's ``last`` unknowns are not asked for;
    ``left`` (last, last) is what elimination adds to their own matrix.
    Raises ComputationError where the matrix is not positive definite.
    """

    def __init__(self, layout: Layout, parts: list[Summand]) -> None:
        self.layout = layout
        self.data: Array = np.empty(layout.entries)
        window: Array = np.zeros((0, 0), order="F")
        for i in range(len(layout.ends)):
            start, stop = int(layout.starts[i]), int(layout.starts[i + 1])
            width, height = stop - start, int(layout.ends[i]) - start
            front = np.zeros((height, height), order="F")
            front[: len(window), : len(window)] = window
            for part in parts:
                # above the diagonal too, where nothing is read
                _add(front.T, layout.order[start:stop], layout.place, start, *part)
            own, failed = dpotrf(front[:width, :width], lower=1, clean=1)
            if failed:
                raise ComputationError("the effective matrix is not positive definite")
            inverse, _ = dtrtri(own, lower=1)
            window = np.asfortranarray(front[width:, width:])
            below = np.zeros((0, width), order="F")
            if height > width:
                below = dtrsm(1.0, own, front[width:, :width], side=1, lower=1, trans_a=1)
                window = dsyrk(-1.0, below, beta=1.0, c=window, lower=1, overwrite_c=1)
            _pack(self.data[layout.offsets[i] : layout.offsets[i + 1]], inverse, below)
        self.left = np.zeros((layout.last, layout.last))
        self.left[: len(window), : len(window)] = np.tril(window) + np.tril(window, -1).T

    def solve(self, b: Array) -> Array:
        """x (n,) or (n, m) for right-hand sides ``b`` of the same shape, nothing being left out."""
        x = np.empty_like(b, order="F")
        self.backward(self.forward(b)[0], b[:0], x)
        return x

    def forward(self, b: Array) -> tuple[list[Array], Array]:
        """What `backward` goes on from, and what elimination adds to the right-hand sides of the
        last unknowns (last,) or (last, m), for ``b`` over all rows of the matrix."""
        n, last = len(self.layout.order), self.layout.last
        columns = b if b.ndim == 2 else b[:, None]
        step = TOGETHER if columns.shape[1] > FEW else 1
        works = []
        left = np.zeros((last, columns.shape[1]))
        for k in range(0, columns.shape[1], step):
            work = self._gathered(columns[:, k : k + step])
            if len(work) == 1:
                _forward(self.data, self.layout.offsets, self.layout.starts, work[0])
            else:
                self._forward_block(work)
            left[:, k : k + step] = work[:, n : n + last].T
            works.append(work)
        return works, left[:, 0] if b.ndim == 1 else left

    def backward(self, works: list[Array], motion: Array, x: Array) -> None:
        """Write what is eliminated into ``x``, over all rows, the last unknowns being ``motion``
        (last,) or (last, m)."""
        n = len(self.layout.order)
        columns, out = (motion, x) if motion.ndim == 2 else (motion[:, None], x[:, None])
        done = 0
        for work in works:
            own = slice(done, done + len(work))
            done += len(work)
            work[:, n : n + len(motion)] = columns[:, own].T
            if len(work) == 1:
                _backward(self.data, self.layout.offsets, self.layout.starts, work[0])
            else:
                self._backward_block(work)
            _scatter(out[:, own], work, self.layout.order)

    def _gathered(self, b: Array) -> Array:
        """Right-hand sides (m, n and some zeros), the unknowns in the order of elimination."""
        size = len(self.layout.order) + self.layout.last + TRIANGLE + BELOW
        work = np.empty((b.shape[1], size), order="F")
        _gather(work, b, self.layout.order)
        return work

    def _forward_block(self, work: Array) -> None:
        """Every panel once for all of ``work`` (m, n and some zeros), in Fortran's order."""
        starts, triangle = self.layout.starts, self._triangle_space()
        for i in range(len(starts) - 1):
            inverse, below = self._panel(i, triangle)
            start, stop = starts[i], starts[i + 1]
            own = work[:, start:stop]
            dtrmm(1.0, inverse, own, side=1, lower=1, trans_a=1, overwrite_b=1)
            if len(below):
                rest = work[:, stop : stop + len(below)]
                dgemm(-1.0, own, below, beta=1.0, c=rest, trans_b=1, overwrite_c=1)

    def _backward_block(self, work: Array) -> None:
        starts, triangle = self.layout.starts, self._triangle_space()
        for i in range(len(starts) - 2, -1, -1):
            inverse, below = self._panel(i, triangle)
            start, stop = starts[i], starts[i + 1]
            own = work[:, start:stop]
            if len(below):
                rest = work[:, stop : stop + len(below)]
                dgemm(-1.0, rest, below, beta=1.0, c=own, overwrite_c=1)
            dtrmm(1.0, inverse, own, side=1, lower=1, overwrite_b=1)

    def _triangle_space(self) -> Array:
        return np.empty(int(np.diff(self.layout.starts).max(initial=0)) ** 2)

    def _panel(self, i: int, space: Array) -> tuple[Array, Array]:
        """A slice's inverse triangle (w, w) in ``space``, above which anything stands, and what
        lies below it, with zeros."""
        layout = self.layout
        width = int(layout.starts[i + 1] - layout.starts[i])
        panel = self.data[layout.offsets[i] : layout.offsets[i + 1]]
        packed = _unpack(panel, space, width)
        inverse = space[: width * width].reshape(width, width).T
        return inverse, panel[packed:].reshape(width, -1).T


def dense_rows(parts: list[Summand], rows: Index, place: Index, width: int) -> Array:
    """Those ``rows`` (n,) of what ``parts`` add up to, their columns where ``place`` says, (n,
    width); columns at -1 are left out."""
    out = np.zeros((len(rows), width))
    for part in parts:
        _add(out, rows, place, 0, *part)
    return out


@njit
def _add(
    out: Array,
    rows: Index,
    place: Index,
    start: int,
    first: Rows,
    column: Rows,
    value: Array,
    weight: float,
    block: int,
) -> None:
    """Add ``rows`` to those of ``out``, their columns where ``place`` says, from ``start`` on."""
    for i in range(len(rows)):
        node, axis = rows[i] // block, rows[i] % block
        for k in range(first[node], first[node + 1]):
            j = place[column[k] * block + axis] - start
            if j >= 0:
                out[i, j] += weight * value[k]


@njit
def _pack(panel: Array, inverse: Array, below: Array) -> None:
    width, tall = len(inverse), len(below)
    deep = -(-width // TRIANGLE) * TRIANGLE
    k = 0
    for c in range(width):
        for r in range(c // TRIANGLE * TRIANGLE, deep):
            panel[k] = inverse[r, c] if c <= r < width else 0.0
            k += 1
    padded = -(-tall // BELOW) * BELOW
    for c in range(width):
        for r in range(padded):
            panel[k] = below[r, c] if r < tall else 0.0
            k += 1


@njit
def _unpack(panel: Array, triangle: Array, width: int) -> int:
    """Spread the lower triangle to columns of as many numbers; returns how many it took."""
    deep = -(-width // TRIANGLE) * TRIANGLE
    k = 0
    for c in range(width):
        top = c // TRIANGLE * TRIANGLE
        column = triangle[c * width + c : (c + 1) * width]
        packed = panel[k + c - top : k + width - top]
        for r in range(len(column)):
            column[r] = packed[r]
        k += deep - top
    return k


@njit
def _gather(work: Array, b: Array, order: Index) -> None:
    for i in range(len(order)):
        for k in range(len(work)):
            work[k, i] = b[order[i], k]
    work[:, len(order) :] = 0.0


@njit
def _scatter(x: Array, work: Array, order: Index) -> None:
    for i in range(len(order)):
        for k in range(len(work)):
            x[order[i], k] = work[k, i]


@fast
def _add_to(y: Array, factor: float, x: Array) -> None:
    for i in range(len(x)):
        y[i] += factor * x[i]


@fast
def _product(x: Array, y: Array) -> float:
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@njit
def _forward(data: Array, offsets: Index, starts: Index, y: Array) -> None:
    longest = 0
    for i in range(len(offsets) - 1):
        longest = max(longest, starts[i + 1] - starts[i])
    own = np.empty(longest + TRIANGLE)
    for i in range(len(offsets) - 1):
        start, width = starts[i], starts[i + 1] - starts[i]
        deep = -(-width // TRIANGLE) * TRIANGLE
        own[:deep] = 0.0
        k = offsets[i]
        for c in range(width):
            r = c // TRIANGLE * TRIANGLE
            _add_to(own[r:deep], y[start + c], data[k : k + deep - r])
            k += deep - r
        y[start : start + width] = own[:width]
        tall = (offsets[i + 1] - k) // width
        below = y[start + width : start + width + tall]
        for c in range(width):
            _add_to(below, -own[c], data[k : k + tall])
            k += tall


@njit
def _backward(data: Array, offsets: Index, starts: Index, y: Array) -> None:
    for i in range(len(offsets) - 2, -1, -1):
        start, width = starts[i], starts[i + 1] - starts[i]
        deep = -(-width // TRIANGLE) * TRIANGLE
        k = offsets[i]
        for c in range(width):
            k += deep - c // TRIANGLE * TRIANGLE
        tall = (offsets[i + 1] - k) // width
        below = y[start + width : start + width + tall]
        for c in range(width):
            y[start + c] -= _product(data[k : k + tall], below)
            k += tall
        k = offsets[i]
        for c in range(width):
            r = c // TRIANGLE * TRIANGLE
            y[start + c] = _product(data[k : k + deep - r], y[start + r : start + deep])
            k += deep - r
