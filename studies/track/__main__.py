"""The folder as a script: ``python3 -m bristle.studies.track FILM``."""

from ..command.script import as_script

as_script("track")
