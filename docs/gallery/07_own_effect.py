"""
An effect of your own
=====================

You suspect physics that the program does not have. Write it as an *effect*: a small class. Then
every model can compute with it, and the loop looks for it in your data.
"""

# %%
# The suspicion
# -------------
#
# Suppose that your ground is asphalt. When it is hit faster, it is stiffer. As a first guess, the
# contact stiffness grows with a power of the speed of impact.
#
# The class
# ---------
#
# ``docs/examples/my_effect.py`` says just that. An effect has a name, a place where it enters, the
# kinds of data that can show it, and parameters with bounds. The method ``enter`` gets the drop as
# a ``Scene`` and returns a changed copy.

import subprocess
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import bristle

plugin = Path("../examples/my_effect.py")
print(plugin.read_text().split('"""', 2)[2])

# %%
# Drops with the effect
# ---------------------
#
# ``plugins`` names the file, ``effects`` switches the effect on. Everything else is as before.
# Without the effect, the contact time is the same from every height. With it, it is not:

heights_m = [0.01, 0.02, 0.03, 0.05, 0.08]
figure, panels = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for exponent in (0.0, 0.5, 1.0):
    table = bristle.sweep(
        models=["beam"],
        kn_N_m=[2e6],
        height_m=heights_m,
        plugins=[plugin],
        effects=[f"my_effect:exponent={exponent}"],
    )
    panels[0].plot(1e3 * table.y0_m, table.rebound_ratio, "o-", ms=3, label=f"{exponent:g}")
    panels[1].plot(1e3 * table.y0_m, 1e3 * table.contact_time_s, "o-", ms=3)
panels[0].set(xlabel="y0 (mm)", ylabel="y1/y0")
panels[1].set(xlabel="y0 (mm)", ylabel="contact time (ms)")
panels[0].legend(title="exponent")
plt.show()

# %%
# So drops from several heights can show the effect. Try that before you measure anything.

# %%
# Would the loop find it?
# -----------------------
#
# ``bristle synth`` makes a dataset that has the effect and does not declare it. It adds scatter and
# errors of measurement.

folder = Path(tempfile.mkdtemp())
made = folder / "asphalt"
command = [
    *("bristle", "synth", "--plugin", plugin, "--effect", "my_effect:exponent=0.3"),
    *("--drops", "30", "--seed", "1", "--out", made, "--truth", folder / "truth.json"),
]
subprocess.run(command, check=True, capture_output=True)

# %%
# Ask the loop, and give it the plugin. It simulates your effect once and keeps the table.

found = bristle.close_loop(made, no_3d=True, plugins=[plugin])
print(found)

# %%
# Your effect stands beside all the others, with the same tests and the same held-out drops. Compare
# what each explains. The greater the log evidence, the likelier the effect:

ranked = sorted(found.evidence, key=lambda each: -each["log_evidence"])
for each in ranked[:5]:
    print(f"{each['log_evidence']:8.1f}  {', '.join(each['effects']) or 'nothing added'}")

# %%
# Without the plugin the loop can only choose among the effects that it knows, or say *unknown*. It
# cannot name the truth then: a name is as good as the list that it was chosen from.

# %%
# Rules for a good effect
# -----------------------
#
# - The neutral value of a parameter (here 0) must give the drop without the effect.
# - Bounds say what is physically possible. The loop searches everything between them.
# - Declare a source. Whoever reads the page should be able to check it.
# - An effect that needs no simulation can say ``computed = True``, and is then a hundred times
#   faster (see the page on effects).
# - A plugin is code that is run. Use only files that you trust.
