"""The Python interface as a user writes it, right and wrong, for `mypy` alone: nothing runs this.

A mistake that no type checker saw would leave its comment unused, which `mypy` refuses.
"""

import numpy as np

import bristle
from bristle.solver.effects.contact import ContactDamping

bristle.drop(model="beam", kn_N_m=1e6).energy.kinetic_J + 1.0
bristle.sweep(models=["beam"], kn_N_m=np.array([1e6]), height_m=0.05).iloc[0]
bristle.drop(effects=[ContactDamping(c_N_s_m=5.0), "wear:decades=1"])
bristle.Session().drop(model="beam").plot().set_title("one")

bristle.drop(model="solid").fields.stress[0]  # type: ignore[union-attr]
bristle.drop(kn=1e6)  # type: ignore[call-arg]
bristle.drop(model="bar")  # type: ignore[arg-type]
bristle.close_loop()  # type: ignore[call-arg]
bristle.Session().drop(height_m="0.05")  # type: ignore[arg-type]
