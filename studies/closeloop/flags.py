"""Which options does `bristle close-loop` have beside its dataset?"""

from __future__ import annotations

from ..command.flags import Flag

LOOP = "Loop"
ALARM = 0.01

LOOP_FLAGS = (
    Flag("seed", "seed", int, 0, LOOP, "Seed of what is held out and of all that is drawn.", "N"),
    Flag(
        "alarm",
        "alarm",
        float,
        ALARM,
        LOOP,
        "How often data that lack nothing may be said to lack something, over all tests together.",
        "RATE",
    ),
    Flag("no-3d", "no_3d", bool, False, LOOP, "Leave out the confirmation by the 3-D model."),
)
