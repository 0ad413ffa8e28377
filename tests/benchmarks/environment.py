"""The environment of a child that is no rank of its parent's job."""

from __future__ import annotations

import os

# What mpirun, or MPI in this very process, leaves in the environment, and what of it is the user's.
LAUNCHERS = ("OMPI_", "PMIX_", "PMI_", "PRTE_")
KEPT = ("OMPI_MCA_", "OMPI_ALLOW_", "PRTE_MCA_", "PRTE_ALLOW_")


def unlaunched() -> dict[str, str]:
    """This process' environment without what would make a child a rank of its job."""
    return {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(LAUNCHERS) or name.startswith(KEPT)
    }
