"""The folder as a script: ``python3 -m bristle.studies.brush``."""

from ..command.script import as_script

as_script("brush")
