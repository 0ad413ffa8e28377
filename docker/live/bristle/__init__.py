"""Impact of a steel bristle on a hard surface: a 3-D solid, its reduced model, a beam, and what
measurements say that they lack.

    import bristle
    r = bristle.drop(model="solid", tilt_deg=2, friction=0)
    r.rebound_ratio, r.energy.friction_loss_J, r.history
    bristle.sweep(models=["beam", "reduced"], kn_N_m=[1e5, 2e6], height_m=0.05)
    bristle.close_loop("my-drops").effects
    with bristle.Session() as s:  # keeps meshes, matrices and factors between calls
        s.drop(model="solid", kn_N_m=1e6), s.drop(model="solid", kn_N_m=1e7)

See `bristle.studies.api`. What computes is loaded when it is first asked for.
"""

from typing import Any

from .solver.errors import ComputationError, InputError
from .studies import __version__

# The types of these stand in __init__.pyi, which tests/derived.py writes.
__all__ = [
    "BristleWarning",
    "Brush",
    "Calibration",
    "ComputationError",
    "Dataset",
    "Drop",
    "Effect",
    "Energy",
    "InputError",
    "Mesh",
    "Record",
    "Scatter",
    "Session",
    "TimeSteps",
    "Tracks",
    "Verdict",
    "__version__",
    "brush",
    "calibrate",
    "close_loop",
    "drop",
    "its",
    "mesh",
    "scatter",
    "sweep",
    "synth",
    "track",
    "view",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'bristle' has no attribute '{name}'")
    from .studies import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return [*__all__, "meshes", "solver", "studies"]
