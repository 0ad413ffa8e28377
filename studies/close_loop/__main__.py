"""The folder as a script: ``python3 -m bristle.studies.close_loop DATASET``."""

from ..command.script import as_script

as_script("close-loop")
