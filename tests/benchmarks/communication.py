"""A model of a step's communication, and where more ranks cease to pay for one solid.

A slender bar is cut across its length into P parts. A cut is one plane of nodes, whatever P and
the bar's length: n = (p NX + 1)(p NY + 1) nodes of degree p, s = 3 n unknowns. The bar has
N = s (p NZ + 1).

Local work is counted in the bytes that it reads and writes. A step of the conserving march is
  * one solve with the factor L, read once forward and once backward. In any order that runs along
    the bar or halves it, an unknown is eliminated while about the p planes of a layer of cells, and
    the plane behind, wait: nnz(L) = N s (p + 1) / 2 on average, eight bytes each, no indices to
    speak of since they come in dense blocks. Once again each way: 16 nnz(L), at a rate of its own
    (`Machine.solve_B_s`), since dense blocks are small and their order is no stream.
  * one product with M: three directions apart, each node coupled to all of its layers,
    (2 p + 1) n / 2 on average but no more than the (2 p + 1)³ of its cells: 12 bytes each.
  * `VECTORS` reads and writes of a vector in the time scheme.

Communication of a step is
  * with each of two neighbours the unknowns of a product that the other owns: the plane, and the
    layer behind it for those rows of the plane that one has itself: at most s (p + 1) each way;
  * `ALLREDUCES` of a few numbers: the tip's motion, which one rank has, and the energies'. Each
    takes ⌈log₂ P⌉ rounds of a message (recursive doubling; Thakur, Rabenseifner and Gropp, Int. J.
    High Perform. Comput. Appl. 19, 2005);
  * the solve's separators, planes between the parts in a tree of ⌈log₂ P⌉ levels. Forward and
    backward, each level passes a vector of 2 s on, and works on a dense block of 3 s × s that no
    other rank can help with.

So E(P) = T(1) / (P T(P)), T(P) = local(P) + waiting(P). Waiting is the same for long bars and short
ones, so the P at which E falls under a share grows with N; it is found here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from .column import column

BYTES = 8
VECTORS = 60
ALLREDUCES = 4
# The paper's bristle in cells of degree 2: about 5e4, 5e5 and 3e6 unknowns.
SIZES = ((1, 4, 337), (2, 8, 1011), (4, 16, 1685))
SHARES = (0.85, 0.5)
MOST_RANKS = 1 << 20


@dataclass(frozen=True)
class Machine:
    """What a message costs (s, and bytes per s), and how fast a rank reads memory as a stream, and
    a factor in a solve (bytes per s)."""

    latency_s: float
    bandwidth_B_s: float
    memory_B_s: float
    solve_B_s: float

    def message_s(self, size_B: float) -> float:
        return self.latency_s + size_B / self.bandwidth_B_s


@dataclass(frozen=True)
class Bar:
    """A flat wire of hexahedra: (NX, NY, NZ) cells of degree ``order``."""

    cells: tuple[int, int, int]
    order: int = 2

    @property
    def plane_nodes(self) -> int:
        """Nodes of a cross-section, which is what a cut takes."""
        nx, ny, _ = self.cells
        return (self.order * nx + 1) * (self.order * ny + 1)

    @property
    def plane(self) -> int:
        """Unknowns of a cross-section."""
        return 3 * self.plane_nodes

    @property
    def unknowns(self) -> int:
        return self.plane * (self.order * self.cells[2] + 1)

    @property
    def factor_entries(self) -> float:
        return self.unknowns * self.plane * (self.order + 1) / 2.0

    @property
    def mass_entries(self) -> float:
        coupled = (2 * self.order + 1) * min(self.plane_nodes / 2.0, (2 * self.order + 1) ** 2)
        return self.unknowns * coupled

    @property
    def most_ghosts(self) -> int:
        """Unknowns at most that one side of a cut needs of the other in a product."""
        return self.plane * (self.order + 1)


def solve_B(bar: Bar) -> float:
    """Bytes of the factor that a solve reads on one rank."""
    return 2.0 * BYTES * bar.factor_entries


def stream_B(bar: Bar) -> float:
    """Bytes that all ranks together read and write in a step beside the factor."""
    return 12.0 * bar.mass_entries + VECTORS * BYTES * bar.unknowns


def neighbours(rank: int, ranks: int) -> int:
    """How many ranks a part of the bar touches: also its messages in a product."""
    return (rank > 0) + (rank < ranks - 1)


def waiting_s(bar: Bar, ranks: int, machine: Machine) -> float:
    """What a step waits for on more than one rank, in s."""
    if ranks == 1:
        return 0.0
    levels = math.ceil(math.log2(ranks))
    scatter = min(ranks - 1, 2) * machine.message_s(BYTES * bar.most_ghosts)
    reduce = ALLREDUCES * levels * machine.message_s(3 * BYTES * bar.plane)
    passed = 2 * levels * machine.message_s(2 * BYTES * bar.plane)
    alone = 2 * levels * BYTES * 3 * bar.plane**2 / machine.memory_B_s
    return scatter + reduce + passed + alone


def step_s(bar: Bar, ranks: int, machine: Machine) -> float:
    """A step of the solid at full order on so many ranks, in s."""
    local = solve_B(bar) / machine.solve_B_s + stream_B(bar) / machine.memory_B_s
    return local / ranks + waiting_s(bar, ranks, machine)


def efficiency(bar: Bar, ranks: int, machine: Machine) -> float:
    """Time on one rank over ``ranks`` times that on ``ranks``."""
    return step_s(bar, 1, machine) / (ranks * step_s(bar, ranks, machine))


def last_ranks(bar: Bar, share: float, machine: Machine) -> int:
    """The greatest number of ranks, as a power of two, that is at least so efficient.

    No more than there are layers of cells, of which each rank needs one.
    """
    ranks = 1
    while 2 * ranks <= min(bar.cells[2], MOST_RANKS):
        if efficiency(bar, 2 * ranks, machine) < share:
            break
        ranks *= 2
    return ranks


@dataclass(frozen=True)
class Prediction:
    """A size's step in s on one rank, the bytes of a cut, and the ranks where scaling ends."""

    unknowns: int = column("Unknowns", digits=0)
    step_s: float = column("A step on one rank", "s")
    cut_B: int = column("A cut", "B")
    local_B: float = column("Read and written", "B")
    ranks_at_85: int = column("85 % to", "ranks", 0)
    ranks_at_50: int = column("50 % to", "ranks", 0)


def prediction(machine: Machine) -> list[Prediction]:
    """For each of ``SIZES``."""
    return [
        Prediction(
            bar.unknowns,
            step_s(bar, 1, machine),
            BYTES * bar.most_ghosts,
            solve_B(bar) + stream_B(bar),
            *(last_ranks(bar, share, machine) for share in SHARES),
        )
        for bar in map(Bar, SIZES)
    ]
