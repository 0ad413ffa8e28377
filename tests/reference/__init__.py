"""What this program is compared with: exact solutions, and other programs of the same impact.

`exact` and `modal_series` serve the tests. `naive_dolfinx`, `plain_scipy` and `calculix` compute
one impact each, as scripts that `bristle bench` runs beside this program.
"""

from .exact import free_free_timoshenko_hz, pochhammer_chree_hz, rate, rod
from .modal_series import modal_series_rebound, papers_rebound

__all__ = [
    "free_free_timoshenko_hz",
    "modal_series_rebound",
    "papers_rebound",
    "pochhammer_chree_hz",
    "rate",
    "rod",
]
