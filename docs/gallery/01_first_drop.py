"""
First drop
==========

A steel bristle of a road sweeper falls 50 mm onto concrete. How high does it bounce, how long does
it touch, and where does its energy go?
"""

# %%
# One line computes the drop. Without arguments it is the bristle of the paper: a flat steel wire of
# 0.5 × 2.08 × 336.5 mm that falls upright from 50 mm. Its contact with the ground is a spring, the
# normal contact stiffness Kn, of 2 MN/m.

import matplotlib.pyplot as plt

import bristle

drop = bristle.drop()
print(drop)

# %%
# The rebound ratio y1/y0 is the height after the impact divided by the height before it. The result
# has every number by name, in SI units. ``inputs`` holds all inputs, also those that you did not
# give.

print(f"y1/y0            {drop.rebound_ratio:.4f}")
print(f"contact time     {1e3 * drop.contact_time_s:.3f} ms")
print(f"greatest force   {drop.peak_force_N:.1f} N")
print(f"Young's modulus  {drop.inputs.youngs_Pa:.3g} Pa")

# %%
# The flight
# ----------
#
# ``history`` is a pandas DataFrame with the lower tip's height, the centre of mass, the force and
# the penetration over time. It has many rows during the impact and few in flight.

history = drop.history
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.plot(1e3 * history.t_s, 1e3 * history.tip_y_m)
axes.axhline(1e3 * drop.rebound_height_m, ls="--", color="grey", lw=0.8)
axes.set(xlabel="time (ms)", ylabel="height of the lower tip (mm)")
plt.show()

# %%
# The impact
# ----------
#
# The impact is a thousand times shorter than the flight. The force rises, and then it flattens. A
# wave of compression runs up the bristle and comes back from its upper end. Until it is back, the
# upper end does not affect the force at the tip. This takes 2L/c: twice the length L over the speed
# of sound c in steel. A little later the impact ends. The delay comes from the ground, which gives
# way before it pushes back.

first_s = history.t_s[history.penetration_m > 0.0].iloc[0]
during = history[(history.t_s - first_s).between(-2e-5, 1.2 * drop.contact_time_s)]
figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
axes.plot(1e3 * (during.t_s - first_s), during.force_N)
speed_of_sound_m_s = (drop.inputs.youngs_Pa / drop.inputs.density_kg_m3) ** 0.5
round_trip_ms = 1e3 * 2.0 * drop.inputs.length_m / speed_of_sound_m_s
axes.axvline(round_trip_ms, ls="--", color="grey", lw=0.8)
axes.text(round_trip_ms, 2.0, " 2L/c", color="grey")
axes.set(xlabel="time since first touch (ms)", ylabel="force (N)")
plt.show()

# %%
# The energy
# ----------
#
# The drop ends when the bristle comes down again. Its kinetic energy is then y1/y0 times the energy
# that it had at the start. The damping of the material took the rest. ``numerical_J`` is the energy
# that the time stepper adds or removes. It should be nothing but rounding.

energy = drop.energy
for name in ("initial_J", "kinetic_J", "strain_J", "potential_J", "material_loss_J", "numerical_J"):
    print(f"{name:<18}{1e6 * energy[name]:10.4f} µJ")

# %%
# Does the height matter?
# -----------------------
#
# The paper measured y1/y0 = 0.65 ± 0.21 from five heights. In the model all heights give the same
# ratio, because everything in an upright impact is proportional to the speed. ``sweep`` computes
# every combination of the lists that it is given.

table = bristle.sweep(models=["beam", "reduced"], kn_N_m=[2e6], height_m=[0.01, 0.03, 0.05])
print(table[["model", "y0_m", "rebound_ratio", "peak_force_N"]])

# %%
# The beam and the reduced solid agree. ``reduced`` is the default: it is the 3-D solid, described
# by a few patterns of motion. Use ``model="solid"`` for stress in the bristle.
#
# What to try next:
#
# - ``bristle.drop(material="nylon")``: another material;
# - ``bristle.drop(kn_N_m=1e8)``: a harder contact, and a warning about the time step;
# - the next lesson, which chooses Kn and the time step.
