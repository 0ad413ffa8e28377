"""Inputs of `bristle close-loop` beside its dataset."""

from __future__ import annotations

from typing import Annotated

from .fields import Plugins, Truth, between, whole
from .flags import Fields, Option, flags_of

LOOP = "Loop"
ALARM = 0.01


class LoopInputs(Fields, group=LOOP):
    """Every option of `bristle close-loop`, checked."""

    plugins: Plugins = ()
    seed: Annotated[
        int,
        whole(0, 2**32 - 1),
        Option("Seed of what is held out and of all that is drawn.", "N"),
    ] = 0
    alarm: Annotated[
        float,
        between(1e-3, 0.3),
        Option(
            "How often data that lack nothing may be said to lack something, over all tests "
            "together.",
            "RATE",
        ),
    ] = ALARM
    no_3d: Annotated[Truth, Option("Leave out the confirmation by the 3-D model.")] = False


LOOP_FLAGS = flags_of(LoopInputs)
