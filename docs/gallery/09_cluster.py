"""
A cluster run
=============

One drop takes a second. A study takes thousands of them, and solids take longer. Use more ranks.
"""

# %%
# Many ranks on one machine
# -------------------------
#
# Put ``mpirun -n N`` before any command. The drops are shared out, and the results are the same as on one
# rank. Here two ranks compute 24 drops:

import subprocess
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

folder = Path(tempfile.mkdtemp())
study = [
    *("bristle", "sweep", "--models", "beam", "--out", folder / "sweep"),
    *("--kn", "1e5,3e5,1e6,2e6,1e7,1e8", "--heights", "0.01,0.02,0.03,0.05"),
]
done = subprocess.run(
    ["mpirun", "-n", "2", *study], capture_output=True, text=True, check=True, stdin=subprocess.DEVNULL
)
print(done.stdout)

# %%
# The table has a row per drop:

table = pd.read_csv(folder / "sweep" / "table.csv")
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for height_m, rows in table.groupby("y0_m"):
    axes.loglog(rows.kn_N_m, rows.peak_force_N, "o-", ms=3, label=f"{1e3 * height_m:.0f} mm")
axes.set(xlabel="Kn (N/m)", ylabel="greatest force (N)")
axes.legend(title="height")
plt.show()

# %%
# The force grows with Kn only while the contact is softer than the bristle. Then it stays at what the
# wave in the bristle allows.

# %%
# Interrupted? Resume
# -------------------
#
# Clusters end jobs that take too long. A study writes each case down as soon as it is known. Give the same
# command with ``--resume``, and it computes only what is missing. To try it, ask for a larger study in the
# same folder. The 24 drops above are kept if they are part of it:

more = [*study, "--resume"]
more[more.index("--kn") + 1] = "1e5,3e5,1e6,2e6,5e6,1e7,3e7,1e8"
again = subprocess.run(
    ["mpirun", "-n", "2", *more], capture_output=True, text=True, stdin=subprocess.DEVNULL
)
print(again.returncode, again.stdout[:300], again.stderr[-300:])
print(len(pd.read_csv(folder / "sweep" / "table.csv")), "drops")
