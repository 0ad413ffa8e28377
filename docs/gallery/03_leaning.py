"""
A leaning bristle
=================

Real bristles do not fall exactly upright. What does a lean of a few degrees change?
"""

# %%
# An upright bristle lands on its whole end face. A bristle that leans lands on one edge. It may
# slide, it bends, and it flies off turning. Compute one that leans by 2° toward its thin side:

import matplotlib.pyplot as plt

import bristle

drop = bristle.drop(tilt_deg=2.0)
print(drop)

# %%
# Two numbers are new. ``cm_rebound_ratio`` is the rebound of the centre of mass. For a bristle that
# turns it says more than the rebound of the tip. ``spin_after_rad_s`` says how fast the bristle
# turns about its three axes after the impact.

print(f"tip             y1/y0 = {drop.rebound_ratio:.4f}")
print(f"centre of mass  y1/y0 = {drop.cm_rebound_ratio:.4f}")
print("spin (rad/s)   ", [round(each, 2) for each in drop.spin_after_rad_s])

# %%
# Friction decides
# ----------------
#
# Vary the lean and the friction. ``sweep`` takes a list for every input.

leans_deg = [0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
table = bristle.sweep(
    models=["beam"],
    tilt_deg=leans_deg,
    friction=[0.0, 0.05, 0.1, 0.5],
    height_m=[0.05],
    kn_N_m=[2e6],
)
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for friction, rows in table.groupby("friction"):
    axes.plot(rows.tilt_deg, rows.cm_rebound_ratio, "o-", ms=3, label=f"{friction:g}")
axes.set(xlabel="lean (°)", ylabel="y1/y0 of the centre of mass")
axes.legend(title="friction")
plt.show()

# %%
# With friction the tip sticks, and the lean changes little. A little friction is enough for a small
# lean: at 0.05 the tip sticks up to 3°. Without friction the tip slides away. The bristle then
# bends and turns, and this energy is missing from the height. A few degrees take most of the
# rebound.
#
# Steel on concrete has friction. If your drops scatter much more than your readings of their
# heights, look for water, oil or dust on the surface before you blame the lean.

# %%
# Do not use linear theory here
# -----------------------------
#
# The force of the impact is a hundred times the load that would buckle the bristle slowly. It acts
# on an axis that is bent already, and bends it further. Linear theory (``deflection="small"``)
# leaves this out. The default for a leaning beam or reduced solid, ``deflection="second-order"``,
# includes it. Here are both. Python warns of each linear drop that leans:

table = bristle.sweep(
    models=["beam"],
    tilt_deg=leans_deg,
    deflection=["small", "second-order"],
    friction=0.0,
    height_m=[0.05],
    kn_N_m=[2e6],
)
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for how, rows in table.groupby("deflection"):
    axes.plot(rows.tilt_deg, rows.cm_rebound_ratio, "o-", ms=3, label=how)
axes.set(xlabel="lean (°)", ylabel="y1/y0 of the centre of mass", title="without friction")
axes.legend(title="deflection")
plt.show()

# %%
# A result says what deserves doubt. If you ask for linear theory at 2°, it has a warning with the
# reason and the remedy:

for warning in bristle.drop(tilt_deg=2.0, friction=0.0, deflection="small").warnings:
    print(warning)

# %%
# What to try next:
#
# - ``slope_deg=3``: the ground leans in place of the bristle;
# - ``tip_shape="rounded:radius=1e-4"``: a worn tip touches elsewhere;
# - ``bristle scatter``: thousands of drops that lean by chance.
