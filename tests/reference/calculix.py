"""The same impact by CalculiX: writes its input deck, runs `ccx` if there is one, reads its output.

C3D8 or C3D20 hexahedra; the end face against a fixed block is a contact pair, surface to surface,
with linear pressure-overclosure of slope Kn over the area. `*DYNAMIC, ALPHA=0` is Newmark's average
acceleration. Its steps are no longer than the ITS, and shorter where contact begins and ends: with
DIRECT, ccx 2.20 gives up as the tip leaves. CalculiX damps the contact spring along with the
material, which is another physics, so damping must be left out.

    docker/run python3 tests/reference/calculix.py --cells 1 2 42 --its 1e-5 --beta 0
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from impact import AREA_M2, Array, Impact, March, run

from bristle.solver import paper

# corners of C3D20 as steps of half a cell, and between which of them its other nodes lie
CORNERS = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)]
EDGES = ((0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3), (1, 2, 3, 0, 5, 6, 7, 4, 4, 5, 6, 7))
BLOCK_M = 1e-3
NOT_INSTALLED = 3


def nodes_and_elements(impact: Impact) -> tuple[dict[tuple[int, int, int], int], list[list[int]]]:
    """Node numbers by place in half cells, and the elements' nodes; the end face comes first."""
    steps = list(CORNERS)
    if impact.order == 2:
        ends = zip(*EDGES, strict=True)
        steps += [tuple(np.add(CORNERS[a], CORNERS[b]) // 2) for a, b in ends]
    nx, ny, nz = impact.cells
    cells = [(2 * i, 2 * j, 2 * k) for k, j, i in itertools.product(*map(range, (nz, ny, nx)))]
    places = [[tuple(map(int, np.add(cell, step))) for step in steps] for cell in cells]
    used = sorted({place for each in places for place in each}, key=lambda place: place[::-1])
    number = {place: i + 1 for i, place in enumerate(used)}
    return number, [[number[place] for place in each] for each in places]


def deck(impact: Impact) -> str:
    """The input deck, in SI units."""
    if impact.beta_s:
        raise SystemExit("CalculiX damps the contact with the material: take --beta 0")
    number, elements, h = *nodes_and_elements(impact), impact.its_s
    size = np.array([paper.THICKNESS_M, paper.WIDTH_M, paper.LENGTH_M])
    scale = size / (2.0 * np.array(impact.cells))
    middle = np.array([0.5, 0.5, 0.0]) * size
    nodes = [(n, *(np.array(place) * scale - middle)) for place, n in number.items()]
    block = len(number) + 1 + np.arange(8)
    corners = (np.array(CORNERS) / 2.0 - [0.5, 0.5, 1.0]) * [*(2.0 * size[:2]), BLOCK_M]
    kind = {1: "C3D8", 2: "C3D20"}[impact.order]
    first = len(elements) + 1
    tip = sorted(n for place, n in number.items() if place[2] == 0)
    faces = range(1, impact.cells[0] * impact.cells[1] + 1)
    lines = [
        "*NODE, NSET=BRISTLE",
        *(f"{n}, {x:.12e}, {y:.12e}, {z:.12e}" for n, x, y, z in nodes),
        "*NODE, NSET=BLOCK",
        *(
            f"{n}, {x:.12e}, {y:.12e}, {z:.12e}"
            for n, (x, y, z) in zip(block, corners, strict=True)
        ),
        f"*ELEMENT, TYPE={kind}, ELSET=BRISTLE",
        *(_wrapped([i + 1, *each]) for i, each in enumerate(elements)),
        "*ELEMENT, TYPE=C3D8, ELSET=BLOCK",
        _wrapped([first, *map(int, block)]),
        "*NSET, NSET=TIP",
        *(f"{n}," for n in tip),
        "*SURFACE, NAME=FACE, TYPE=ELEMENT",
        *(f"{i}, S1" for i in faces),
        "*SURFACE, NAME=PLANE, TYPE=ELEMENT",
        f"{first}, S2",
        "*MATERIAL, NAME=STEEL",
        "*ELASTIC",
        f"{paper.YOUNGS_PA:.12e}, {paper.POISSON}",
        "*DENSITY",
        f"{paper.DENSITY_KG_M3}",
        "*SOLID SECTION, ELSET=BRISTLE, MATERIAL=STEEL",
        "*SOLID SECTION, ELSET=BLOCK, MATERIAL=STEEL",
        "*SURFACE INTERACTION, NAME=SPRING",
        "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
        f"{impact.kn_N_m / AREA_M2:.12e}",
        "*CONTACT PAIR, INTERACTION=SPRING, TYPE=SURFACE TO SURFACE",
        "FACE, PLANE",
        "*BOUNDARY",
        "BLOCK, 1, 3",
        "*INITIAL CONDITIONS, TYPE=VELOCITY",
        f"BRISTLE, 3, {-impact.speed_m_s:.12e}",
        "*STEP, INC=1000000",
        "*DYNAMIC, ALPHA=0.",
        f"{h:.12e}, {impact.until_s:.12e}, {1e-4 * h:.12e}, {h:.12e}",
        "*DLOAD",
        f"BRISTLE, GRAV, {paper.GRAVITY_M_S2}, 0., 0., -1.",
        "*NODE PRINT, NSET=BLOCK, TOTALS=ONLY",
        "RF",
        "*NODE PRINT, NSET=TIP",
        "U",
        "*END STEP",
    ]
    return "\n".join(lines) + "\n"


def _wrapped(numbers: list[int]) -> str:
    """Numbers of an element, ten on a line."""
    rows = [numbers[i : i + 10] for i in range(0, len(numbers), 10)]
    return ",\n".join(", ".join(map(str, row)) for row in rows)


def tables(text: str) -> list[tuple[str, float, Array]]:
    """The blocks of a .dat file: title, time, and rows of numbers."""
    found = []
    for part in re.split(r"\n(?= *\S.*\btime\b)", text):
        head, _, rest = part.strip().partition("\n")
        if "time" not in head:
            continue
        rows = [list(map(float, line.split())) for line in rest.splitlines() if line.strip()]
        found.append((head, float(head.split()[-1]), np.array(rows)))
    return found


def march(impact: Impact) -> March:
    """Run ccx in a folder of its own; SystemExit where it is not installed or fails."""
    program = shutil.which("ccx")
    text = deck(impact)
    if program is None:
        print("ccx is not installed", file=sys.stderr)
        raise SystemExit(NOT_INSTALLED)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "impact.inp").write_text(text)
        environment = {**os.environ, "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}
        done = subprocess.run(
            [program, "impact"], cwd=folder, env=environment, capture_output=True, text=True
        )
        told = Path(folder, "impact.dat")
        if done.returncode or not told.exists() or "*ERROR" in done.stdout:
            raise SystemExit(f"ccx failed:\n{done.stdout[-2000:]}")
        found = tables(told.read_text())
    return seen(impact, found)


def seen(impact: Impact, found: list[tuple[str, float, Array]]) -> March:
    """Force on the block and mean height of the tip at the ends of the steps."""
    forces = [(time, rows[0, 2]) for head, time, rows in found if "force" in head]
    tip = [rows[:, 3].mean() for head, _, rows in found if "displacement" in head]
    number, _ = nodes_and_elements(impact)
    return March(*zip(*forces, strict=True), tip, 3 * len(number))


if __name__ == "__main__":
    sys.exit(run(__doc__, march))
