"""The folder as a script: ``python3 -m bristle.studies.mesh``."""

from ..command.script import as_script

as_script("mesh")
