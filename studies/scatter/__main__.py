"""The folder as a script: ``python3 -m bristle.studies.scatter``."""

import sys

from .run import main

sys.exit(main(sys.argv[1:]))
