"""
A cluster run
=============

One drop takes a second. A study may take thousands of drops, and solids take longer. Use more
processes, which are called ranks.
"""

# %%
# Many ranks on one machine
# -------------------------
#
# Put ``mpirun -n N`` before any command. The drops are shared out, and the results are the same as
# on one rank. Here two ranks compute 24 drops:

import signal
import subprocess
import tempfile
import time
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

folder = Path(tempfile.mkdtemp())
study = [
    *("bristle", "sweep", "--models", "beam", "--out", folder / "sweep"),
    *("--kn", "1e5,3e5,1e6,2e6,1e7,1e8", "--heights", "0.01,0.02,0.03,0.05"),
]
done = subprocess.run(
    ["mpirun", "-n", "2", *study],
    capture_output=True,
    text=True,
    check=True,
    stdin=subprocess.DEVNULL,
)
print(done.stdout)

# %%
# The table has a row per drop:

table = pd.read_csv(folder / "sweep" / "table.csv")
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for height_m, rows in table.groupby("y0_m"):
    axes.semilogx(
        rows.kn_N_m, 1e3 * rows.contact_time_s, "o-", ms=3, label=f"{1e3 * height_m:.0f} mm"
    )
axes.set(xlabel="Kn (N/m)", ylabel="contact time (ms)", ylim=(0, None))
axes.legend(title="height")
plt.show()

# %%
# The contact time falls with Kn while the contact is softer than the bristle. Then it stays at the
# time that the wave needs to run up the bristle and down again.

# %%
# Interrupted? Resume
# -------------------
#
# Clusters end jobs that take too long. A study writes each case into ``cases.jsonl`` as soon as it
# is known. To try this, start a study of leaning bristles and end it after five cases, as a cluster
# would:

leaning = [
    *("bristle", "sweep", "--models", "reduced", "--kn", "2e6", "--out", folder / "leaning"),
    *("--heights", "0.01,0.02,0.03,0.04,0.05", "--friction", "0,0.05,0.1"),
    *("--tilt", "0.5,1,1.5,2,2.5,3,3.5,4"),
]
journal = folder / "leaning" / "cases.jsonl"


def cases() -> int:
    """How many cases the journal has."""
    return len(journal.read_text().splitlines()) if journal.exists() else 0


job = subprocess.Popen(leaning, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
while job.poll() is None and cases() < 5:
    time.sleep(0.05)
job.send_signal(signal.SIGTERM)
print(f"ended with status {job.wait()}; the journal has {cases()} lines")

# %%
# Give the same command with ``--resume``. It computes only what is missing:

subprocess.run([*leaning, "--resume"], check=True, capture_output=True)
table = pd.read_csv(folder / "leaning" / "table.csv")
print(len(table), "drops in the table")

# %%
# On a cluster
# ------------
#
# A cluster has no docker, but most have Apptainer. Build the image once, on any machine that has
# it::
#
#     apptainer build bristle.sif docker/bristle.def
#
# Then hand in a job. ``docker/cluster.sbatch`` is one for Slurm: two nodes with 16 ranks each. The
# options behind it go to ``bristle sweep``::
#
#     sbatch docker/cluster.sbatch --kn 1e5,2e6,1e8
#
# Change three things in that file for your cluster: the nodes and ranks, the time, and the memory.
#
# - Beams and reduced solids: one drop per rank at a time. Memory is no concern.
# - Solids at full order: several ranks may share one solid. ``--ranks-per-case N`` says how many.
#   Without it, the program takes the number that it estimates to be the fastest.
# - If a job ran out of time, hand it in again with ``--resume`` and with the same ``--out``.
#
# The same in Python
# ------------------
#
# A script of your own may be started by ``mpirun`` too. Every rank makes the same calls and gets
# the same results::
#
#     # study.py; start it with: mpirun -n 8 python3 study.py
#     import bristle
#
#     table = bristle.sweep(models=["solid"], kn_N_m=[1e5, 2e6, 1e8], out="results/study")
