"""A study as a script: run by Python's -m, it is the command of its name."""

import sys
from importlib import import_module


def as_script(name: str) -> None:
    """Run the command ``name`` with the script's arguments, and exit with its status.

    The command line knows the studies and is not known to them: it is looked up by name here.
    """
    sys.exit(import_module("bristle.studies.cli").main([name, *sys.argv[1:]]))
