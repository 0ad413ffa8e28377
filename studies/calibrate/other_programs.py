"""A normal contact stiffness in the terms of other finite element programs.

Kn is a force over a penetration of the whole end face. Programs that take a pressure over a
penetration want it over the face's area; programs that have springs at nodes want it divided among
the nodes that touch, one on the axis of a beam, as in the paper.
"""

from __future__ import annotations

import pandas as pd

AREA, NODE = "Kn over the face's area", "Kn over the nodes that touch"
# Program, where the number is entered, and what it is there. From the programs' manuals.
OPTIONS = (
    ("Abaqus", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR, between surfaces", AREA),
    ("Abaqus", "the same, of a node-based surface", NODE),
    ("Ansys", "FKN of CONTA174, with a minus sign to be absolute, KEYOPT(3) = 0", AREA),
    ("Ansys", "FKN of CONTA175, with a minus sign to be absolute, KEYOPT(3) = 0", NODE),
    ("CalculiX", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", AREA),
    ("Code_Aster", "E_N of DEFI_CONTACT, FORMULATION='DISCRETE', PENALISATION", NODE),
    ("COMSOL", "pressure penalty factor of the contact node, penalty method", AREA),
)


def programs(kn_N_m: float, area_m2: float) -> pd.DataFrame:
    """What to enter where, for a face of ``area_m2``."""
    values = {AREA: (kn_N_m / area_m2, 1e-9 * kn_N_m / area_m2), NODE: (kn_N_m, 1e-3 * kn_N_m)}
    rows = [(*option, *values[option[-1]]) for option in OPTIONS]
    return pd.DataFrame(rows, columns=["program", "option", "is", "value_si", "value_mm"])
