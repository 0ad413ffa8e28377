"""How often somebody writes a number down wrongly, and what follows for what is far off.

People who copy numbers err in about one of a hundred (K. A. Barchard and L. A. Pace, Comput. Human
Behav. 27 (2011) 1834); one in ten of these errors is taken to have no pattern.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import poisson

from ...solver.arrays import Array

SLIP, ANYTHING = 0.01, 0.001
# Probability of a slip above which what was written is set aside.
SURE = 0.95
# More slips than this chance allows are none.
TOO_MANY = 1e-3
# Of fewer rows or records none is set aside.
FEWEST = 8
# What could be anything may lie so many times as far off as all that was read.
REACH = 1.2


def are_too_many(found: float, read: int) -> bool:
    """Whether so many slips among what was ``read`` are more than people make."""
    return bool(poisson.sf(found - 1, (SLIP + ANYTHING) * read) < TOO_MANY)


def could_be_anything(left: Array, values: Array) -> bool:
    """Whether a record that leaves ``left`` (rows,), in standard deviations, is likelier to hold
    anything that lies within all ``values`` (n,) than noise."""
    usual = -0.5 * float(left @ left) - 0.5 * left.size * math.log(2.0 * math.pi)
    anything = -left.size * math.log(2.0 * REACH * float(np.abs(values).max()))
    return anything + math.log(ANYTHING) - usual > math.log(SURE / (1.0 - SURE))
