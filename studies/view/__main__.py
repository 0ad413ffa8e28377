"""The folder as a script: ``python3 -m bristle.studies.view RESULT``."""

from ..command.script import as_script

as_script("view")
