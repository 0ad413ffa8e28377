"""The folder as a script: ``python3 -m bristle.studies.closeloop DATASET``."""

import sys

from ..cli import main

sys.exit(main(["close-loop", *sys.argv[1:]]))
