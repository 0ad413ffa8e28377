"""The folder as a script: ``python3 -m bristle.studies.calibrate DATASET``."""

from ..command.script import as_script

as_script("calibrate")
