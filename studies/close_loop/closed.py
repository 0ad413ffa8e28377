"""A loop that ran: all that its page and its verdict are made from."""

from __future__ import annotations

from dataclasses import dataclass

from ..data.datasets import Manifest
from ..inputs.study_fields import LoopInputs
from ..loop.finding import Finding
from ..loop.problem import Problem
from .confirm import Confirmation


@dataclass(frozen=True)
class Closed:
    """A loop that ran: what was asked, the data as a problem, what was found, and in 3-D."""

    manifest: Manifest
    inputs: LoopInputs
    problem: Problem
    finding: Finding
    confirmation: Confirmation
