"""
Kn and ITS for your own program
===============================

You have a model of a bristle in Abaqus, Ansys, CalculiX or LS-DYNA. Two settings are up to you: the
normal contact stiffness Kn and the integration time step ITS. Which values do you take?
"""

# %%
# Kn from the rebound
# -------------------
#
# The harder the contact, the less the bristle bounces. A hard contact makes a sharp wave, and the
# damping of the material takes more of a sharp wave. First compute the curve:

import matplotlib.pyplot as plt
import numpy as np

import bristle

kn_N_m = np.geomspace(1e4, 1e8, 25)
curve = bristle.sweep(models=["beam"], kn_N_m=list(kn_N_m), height_m=[0.05], its_s=[1e-6])

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.semilogx(curve.kn_N_m, curve.rebound_ratio, color="black", label="model")
axes.axhspan(0.58, 0.72, color="tab:blue", alpha=0.3, label="mean of the paper's drops, 90 %")
axes.set(xlabel="Kn (N/m)", ylabel="y1/y0")
axes.legend()
plt.show()

# %%
# Then put the measured y1/y0 onto the curve. ``calibrate`` does this with intervals. Give it a
# folder with your own drops (lesson 5 shows one), or ``paper`` for what the paper published:

found = bristle.calibrate("paper")
print(found)

# %%
# The doubts at the end matter. A rebound ratio is a single number, and several things change it:
# stiffness, damping in the contact, damping in the material, lean and friction. If you can measure
# the contact time or the force as well, do it.

# %%
# Where to enter Kn
# -----------------
#
# Kn is a force over a penetration, for the whole end face: N/m. Programs ask for it in one of two
# ways:
#
# - as pressure over penetration. Divide Kn by the area of the end face;
# - as a spring at each node that touches. Divide Kn by the number of these nodes.
#
# The table of the calibration has both, in m and N and in mm and N:

for _, row in found.programs.iterrows():
    print(f"{row.program}: {row.option}")
    print(f"    {row['is']}: {row.value_si:.3g} with m and N, {row.value_mm:.4g} with mm and N")

# %%
# LS-DYNA's penalty contact takes no stiffness of its own. It computes one from the bulk modulus and
# the size of the elements, and scales it by ``SLSFAC`` (``*CONTROL_CONTACT``) and by ``SFS`` and
# ``SFM`` (``*CONTACT``, card 3; newer manuals call them ``SFSA`` and ``SFSB``). Keep ``SOFT=0``,
# since the other values make the stiffness depend on the time step. Then find the scale by the test
# below. Or put a spring at the tip in place of the contact: ``*ELEMENT_DISCRETE`` with
# ``*MAT_SPRING_NONLINEAR_ELASTIC`` and a curve that has a force in compression only.
#
# Whatever your program: **test it**. Press the bristle onto the ground slowly, with a known force
# F, and keep it upright. Read the penetration δ of the tip into the ground. F/δ must be Kn.

# %%
# Three more settings must fit
# ----------------------------
#
# - **No damping in the contact.** The Kn found above belongs to a contact that loses nothing.
#   Rayleigh damping by β must act on the bristle alone. CalculiX damps the contact springs together
#   with the material; compare it with β = 0 first.
# - **No numerical damping.** Most programs have some by default. The table below says how to switch
#   it off.
# - **The β of your material.** The default here, 1.07e-5 s, was found on steel bristles.
#
# ================== =====================================================================
# program            no numerical damping
# ================== =====================================================================
# Abaqus/Standard    ``*DYNAMIC, APPLICATION=TRANSIENT FIDELITY, ALPHA=0``
# Ansys              ``TINTP, 0`` (the default is 0.005, in Workbench 0.1)
# CalculiX           ``*DYNAMIC, ALPHA=0`` (the default is -0.05)
# LS-DYNA, implicit  ``GAMMA=0.5`` and ``BETA=0.25`` in ``*CONTROL_IMPLICIT_DYNAMICS``
# ================== =====================================================================

# %%
# ITS: how short must the time step be?
# -------------------------------------
#
# Now compute the same impact with several time steps, for three Kn. The shortest one serves as the
# reference.

its_s = np.geomspace(1e-4, 1e-7, 13)
steps = bristle.sweep(
    models=["beam"], kn_N_m=[1e5, 2e6, 1e8], height_m=[0.05], its_s=list(its_s), elements=64
)
quantities = {"rebound_ratio": "rebound ratio", "peak_force_N": "peak force"}
figure, panels = plt.subplots(1, 2, figsize=(9, 3.5), sharey=True, layout="constrained")
for axes, (name, title) in zip(panels, quantities.items(), strict=True):
    for stiffness, rows in steps.groupby("kn_N_m"):
        reference = rows.loc[rows.its_s.idxmin(), name]
        rows = rows[rows.its_s > rows.its_s.min()]
        axes.loglog(1e3 * rows.its_s, abs(rows[name] / reference - 1), label=f"{stiffness:.0e} N/m")
    axes.axhline(0.01, ls="--", color="grey", lw=0.8)
    axes.set(xlabel="ITS (ms)", title=title)
panels[0].set_ylabel("relative error")
panels[0].set_ylim(1e-6, 1)
panels[0].legend(title="Kn")
plt.show()

# %%
# Read the longest step below the dashed line, which marks 1 %:

for stiffness, rows in steps.groupby("kn_N_m"):
    for name, title in quantities.items():
        ordered = rows.sort_values("its_s")
        error = abs(ordered[name] / ordered[name].iloc[0] - 1)
        good = (error < 0.01).cummin()
        longest_ms = 1e3 * ordered.its_s[good].max()
        print(f"Kn {stiffness:.0e} N/m, {title:<14} ITS up to {longest_ms:.1e} ms")

# %%
# For the rebound, 0.01 ms is short enough. Forces need shorter steps. The harder the contact, the
# shorter the step must be. ``bristle its`` makes this study for all the paper's stiffnesses.
#
# These steps are for implicit programs. Explicit ones have a shorter limit of their own: the time
# of a wave through the smallest element.

# %%
# Where to enter ITS
# ------------------
#
# The step must be fixed. A program that chooses its step takes long steps in flight, and can step
# over the impact.
#
# ================== =====================================================================
# program            fixed step
# ================== =====================================================================
# Abaqus/Standard    ``*DYNAMIC, DIRECT``; the first number of the next line is the ITS
# Ansys              ``DELTIM, its, its, its`` and ``AUTOTS, OFF``
# CalculiX           ``*DYNAMIC, DIRECT``; the first number of the next line is the ITS
# LS-DYNA, implicit  ``DT0`` of ``*CONTROL_IMPLICIT_GENERAL``, ``IAUTO=0`` of
#                    ``*CONTROL_IMPLICIT_AUTO``
# ================== =====================================================================
#
# Start your model just above the ground, with the speed of impact √(2 g y0). Then the fall needs no
# steps.
