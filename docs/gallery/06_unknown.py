"""
What "unknown" means
====================

Sometimes the loop says *unknown*: something is missing, and no effect that it knows explains it.
This is an answer. What do you do with it?
"""

# %%
# Here are 16 drops whose verdict is *unknown*. They are made up, as in lesson 5.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy import stats

import bristle

data = Path("data/every-second")
folder = Path(tempfile.mkdtemp())
found = bristle.close_loop(data, no_3d=True, out=folder)
print(found)

# %%
# The loop does not name an effect just because it fits better than nothing. The last line says
# which effect came nearest, how much of the misfit it explains, and why it was refused. The words
# in brackets name the test that the rest failed. Take them as a hint where to look. Here they point
# to the order of the drops: one in several drops differs.

# %%
# Step 1: look at the residuals
# -----------------------------
#
# A residual is the measured value minus the predicted one, in units of sigma. ``residuals.csv`` has
# them with the height, the number of the drop and the quantity. Draw them against everything that
# you know of the drops. The height shows little, the order shows more:

residuals = pd.read_csv(folder / "tables" / "residuals.csv")
heights = residuals[residuals.quantity == "y1 (mm)"]
figure, panels = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True, layout="constrained")
panels[0].plot(heights.height, heights.before, "o", color="black")
panels[0].set(xlabel="y0 (mm)", ylabel="residual of y1 (sigma)")
even = heights.group % 2 == 0
panels[1].plot(heights.group, heights.before, "-", color="lightgrey")
panels[1].plot(heights.group[even], heights.before[even], "o", label="even numbers")
panels[1].plot(heights.group[~even], heights.before[~even], "s", label="odd numbers")
panels[1].set(xlabel="number of the drop")
panels[1].legend()
plt.show()

# %%
# Almost all drops with an odd number bounce too high, and almost all with an even number too low.

# %%
# Step 2: which quantities are concerned?
# ---------------------------------------
#
# A change of the bristle or the ground would show in contact times and forces as well. Compare the
# means of odd and even drops:

residuals["numbers"] = residuals.group.map(lambda number: "odd" if number % 2 else "even")
means = residuals.groupby(["quantity", "numbers"]).before.agg(["mean", "sem"])
print(means.round(2))

# %%
# The heights differ far more than times and forces do, so the impact is nearly the same in all
# drops. Suspect what happens to the bristle after the impact, or how the heights are read.

# %%
# Step 3: test the suspicion
# --------------------------
#
# You found the pattern by looking, and who looks long enough always finds one. So ask how often
# chance alone makes a difference this large. Deal the words *odd* and *even* out to the drops at
# random, many times:


def apart(odd, even, axis):
    """Difference of the means of two groups of residuals."""
    return np.mean(odd, axis=axis) - np.mean(even, axis=axis)


groups = [heights.before[~even], heights.before[even]]
chance = stats.permutation_test(groups, apart, n_resamples=9999, rng=np.random.default_rng(0))
print(f"difference {chance.statistic:.2f} sigma, by chance in {chance.pvalue:.2g} of all deals")

# %%
# The number is small. Besides, the loop's own test named this pattern, and that test allows for all
# its attempts. If you want the loop to look exactly there, add a column ``session`` with *odd* and
# *even* to ``drops.csv`` and run it again.

# %%
# Step 4: decide
# --------------
#
# You now know where and what: every second rebound is read some per cent higher. Go to the
# laboratory with this. Did two people read the ruler in turn? Was the bristle turned round after
# every drop? Then do one of three things:
#
# - mend the cause and measure again;
# - keep only the drops that you trust, and say so;
# - if it is physics, write it as an effect of your own, and the loop will test it: the next lesson.
#
# What you should not do is to take the nearest effect. The loop refused it for a reason, and a
# model with a wrong effect predicts worse than one that is known to lack something.

# %%
# Other hints and what they suggest
# ---------------------------------
#
# ========================== ===================================================================
# the rest failed by         look at
# ========================== ===================================================================
# trend or band of height    the ruler's zero and scale; air; a contact that is not linear
# wave in height             a resonance of the release or of the support
# trend in the order         wear, warming up, drift of a sensor
# one in several             people, sides of the bristle, or places used in turn
# band of session            another day, another set-up
# two states                 the bristle lands in two ways, such as face or edge
# ========================== ===================================================================
