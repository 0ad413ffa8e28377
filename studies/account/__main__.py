"""The folder as a script: ``python3 -m bristle.studies.account``."""

import sys

from .run import main

sys.exit(main())
