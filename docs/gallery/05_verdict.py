"""
From measured drops to a verdict
================================

You have measured drops. Does the model explain them? If not, what does it lack?
"""

# %%
# A dataset is a folder with two files. ``drops.csv`` has one row per drop: the height before, the
# greatest height after and, if you can measure them, the contact time and the greatest force.

import shutil
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

import bristle

data = Path("data/my-drops")
drops = pd.read_csv(data / "drops.csv")
print(drops.head())

# %%
# ``dataset.toml`` says what was measured, and how well. The ``sigma`` values are the uncertainties:
# standard deviations of the errors. Find yours by measuring one drop ten times. Without a table
# ``[body]``, the bristle is the paper's.

print((data / "dataset.toml").read_text())

# %%
# These drops are made up, so that the truth is known. It stands in the source line above. Forget it
# for now.
#
# Look first
# ----------
#
# In the model, y1/y0 does not depend on the height, and neither does the contact time.

figure, (heights, times) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
heights.errorbar(drops.y0_mm, drops.y1_mm, yerr=0.3, fmt=".", color="black")
heights.set(xlabel="y0 (mm)", ylabel="y1 (mm)")
times.plot(drops.y0_mm, drops.contact_time_ms, ".", color="black")
times.set(xlabel="y0 (mm)", ylabel="contact time (ms)", ylim=(0.14, 0.18))
plt.show()

# %%
# Nothing looks wrong here. That is why a test is needed.
#
# Heights alone
# -------------
#
# Suppose that you had only a ruler. Copy the dataset without the times and the forces:

folder = Path(tempfile.mkdtemp())
shutil.copy(data / "dataset.toml", folder)
drops[["drop", "y0_mm", "y1_mm"]].to_csv(folder / "drops.csv", index=False)

ruler = bristle.close_loop(folder, no_3d=True)
print(ruler)

# %%
# The verdict is *adequate*: the model explains these heights, with the stiffness ``kn_N_m`` that it
# fitted. Is this stiffness right? Heights alone cannot say. Damping in the contact and a stiffer
# contact lower the rebound in the same way.
#
# **Adequate means: these data show nothing missing. It does not mean that nothing is missing.**
# ``detectable`` says how large each effect would have to be before these data showed it. *No size*
# means that they would not show it however large it is:

for name, size in ruler.detectable.items():
    print(f"{name:<22}{'no size' if size is None else f'{size:.3g}'}")

# %%
# With contact times and forces
# -----------------------------
#
# Now use all columns. For the first such dataset of a bristle, the loop simulates every effect,
# which takes a few minutes. Later datasets with similar heights use the same tables.

full = bristle.close_loop(data, no_3d=True)
print(full)

# %%
# The verdict is *effect*, and the effect is damping in the contact. Read the lines like this:
#
# - *in words*: what shows that something is missing, and what explains it.
# - *something is missing*: how often chance alone makes data as odd as these. This is very seldom,
#   so the model lacks something.
# - *something is left*: the same after the effect is added. This happens often by chance, so what
#   is left is noise.
# - ``kn_N_m`` and ``c_N_s_m``: stiffness and damping with their 90 % intervals.
# - *held-out error*: some drops took no part in the fit. The model with the effect predicts them
#   much better than the model without.
#
# The truth was Kn = 2 MN/m and a damping of 8 N s/m. The stiffness from the ruler was far off:

figure, axes = plt.subplots(figsize=(6, 2), layout="constrained")
for row, (name, found) in enumerate({"heights alone": ruler, "all columns": full}.items()):
    kn = found.parameters.kn_N_m
    axes.plot([kn.low / 1e6, kn.high / 1e6], [row, row], color="black")
    axes.plot(kn.estimate / 1e6, row, "o", color="black")
    axes.text(2.9, row, name, va="center")
axes.axvline(2.0, ls="--", color="grey")
axes.set(xlabel="Kn (MN/m)", yticks=[], ylim=(-0.5, 1.5), xlim=(1.8, 3.3))
plt.show()

# %%
# What to do with your own drops
# ------------------------------
#
# - Measure the contact time if you can. A wire from the bristle and one from a metal plate are
#   enough.
# - Drop from several heights, in a random order, and number the drops in the order in which you
#   made them. Wear shows in nothing else.
# - Use ``docker/run bristle close-loop FOLDER``. It writes the page with all figures, and the 3-D
#   model confirms the result.
