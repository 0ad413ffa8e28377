"""
Inside the solid
================

You know FEniCSx. This lesson opens the solid: its mesh, its fields over time, and your own forms on
the same mesh.
"""

# %%
# A drop with fields
# ------------------
#
# The full solid keeps its fields. ``until="impact"`` stops after the first impact, and
# ``write_every=2`` keeps every second step. A shorter time step makes the wave sharp.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import ufl
from dolfinx import fem, io
from dolfinx.fem.petsc import LinearProblem

import bristle
from bristle.meshes.geometry import Tag
from bristle.solver import paper

drop = bristle.drop(
    model="solid", cells=(1, 2, 120), kn_N_m=1e7, its_s=1e-6, until="impact", write_every=2
)
fields = drop.fields
print(drop)
print(fields)

# %%
# The wave
# --------
#
# ``fields.stress[i]`` is a dolfinx Function: a tensor of shape (3, 3) at the i-th instant. Take its
# axial component, and average it over each height:

nodes_m = fields.stress[0].function_space.tabulate_dof_coordinates()
levels_m, level = np.unique(np.round(nodes_m[:, 2], 7), return_inverse=True)
stress_Pa = []
for tensor in fields.stress:
    axial_Pa = tensor.x.array.reshape(-1, 3, 3)[:, 2, 2]
    stress_Pa.append(np.bincount(level, axial_Pa) / np.bincount(level))

# %%
# The picture shows the wave: time to the right, height upward, compression in blue. The wave runs
# up with the speed of sound √(E/ρ). The free end turns it into a wave of tension, which cancels the
# compression on its way down. The dashed line is a path with the speed of sound.

time_us = 1e6 * (fields.times_s - fields.times_s[0])
figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
most_MPa = 1e-6 * np.abs(stress_Pa).max()
drawn = axes.pcolormesh(
    time_us,
    1e3 * levels_m,
    1e-6 * np.array(stress_Pa).T,
    cmap="RdBu_r",
    vmin=-most_MPa,
    vmax=most_MPa,
)
figure.colorbar(drawn, label="axial stress (MPa)")
speed_m_s = (paper.YOUNGS_PA / paper.DENSITY_KG_M3) ** 0.5
up_us = 1e6 * paper.LENGTH_M / speed_m_s
axes.plot([0, up_us, 2 * up_us], [0, 1e3 * paper.LENGTH_M, 0], "k--", lw=0.8)
axes.set(xlabel="time since first touch (µs)", ylabel="height in the bristle (mm)")
plt.show()

# %%
# Your own forms
# --------------
#
# UFL forms take these functions as they are. As an example, compute the kinetic energy at each
# instant, and the elastic energy:

density, nu = paper.DENSITY_KG_M3, paper.POISSON
lame = paper.YOUNGS_PA * nu / ((1 + nu) * (1 - 2 * nu))
shear = paper.YOUNGS_PA / (2 * (1 + nu))


def stress(displacement):
    """Hooke's law."""
    strain = ufl.sym(ufl.grad(displacement))
    return lame * ufl.tr(strain) * ufl.Identity(3) + 2 * shear * strain


moving_J, strained_J = [], []
for u, v in zip(fields.displacement, fields.velocity, strict=True):
    kinetic = 0.5 * density * ufl.inner(v, v) * ufl.dx
    elastic = 0.5 * ufl.inner(stress(u), ufl.grad(u)) * ufl.dx
    moving_J.append(fem.assemble_scalar(fem.form(kinetic)))
    strained_J.append(fem.assemble_scalar(fem.form(elastic)))

figure, axes = plt.subplots(figsize=(6, 3), layout="constrained")
axes.plot(time_us, 1e3 * np.array(moving_J), label="kinetic")
axes.plot(time_us, 1e3 * np.array(strained_J), label="elastic")
axes.set(xlabel="time since first touch (µs)", ylabel="energy (mJ)")
axes.legend()
plt.show()
print(f"fall from 50 mm    {1e3 * drop.energy.initial_J:.4f} mJ")
print(f"kinetic at touch   {1e3 * moving_J[0]:.4f} mJ")

# %%
# The same mesh for another problem
# ---------------------------------
#
# ``fields.mesh`` is a plain dolfinx mesh, and ``fields.facet_tags`` mark its tip, top and side. As
# an example, press the bristle slowly: hold its top, push its tip by a force F, and ask how stiff
# it is.

mesh, facets = fields.mesh, fields.facet_tags
space = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u, w = ufl.TrialFunction(space), ufl.TestFunction(space)
tip = ufl.Measure("ds", domain=mesh, subdomain_data=facets)(int(Tag.TIP))
area_m2 = fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * tip))
top = fem.locate_dofs_topological(space, 2, facets.find(Tag.TOP))
held = fem.dirichletbc(np.zeros(3), top, space)

FORCE_N = 40.0
push = fem.Constant(mesh, (0.0, 0.0, FORCE_N / area_m2))
problem = LinearProblem(
    ufl.inner(stress(u), ufl.grad(w)) * ufl.dx,
    ufl.inner(push, w) * tip,
    bcs=[held],
    petsc_options={"ksp_type": "preonly", "pc_type": "lu"},
)
pressed = problem.solve()
shortened_m = fem.assemble_scalar(fem.form(pressed[2] * tip)) / area_m2

print(f"area of the tip   {1e6 * area_m2:.4f} mm²")
print(f"stiffness         {1e-6 * FORCE_N / shortened_m:.4f} MN/m")
print(f"E A / L           {1e-6 * paper.YOUNGS_PA * area_m2 / paper.LENGTH_M:.4f} MN/m")

# %%
# Both agree. Compare them with Kn: a contact of 2 MN/m is stiffer than the whole bristle. That is
# why waves matter in this impact, and why a rigid mass on a spring is a poor model of it.

# %%
# Your own output
# ---------------
#
# Any function on this mesh can be written as usual, for example for ParaView:

folder = Path(tempfile.mkdtemp())
with io.VTXWriter(mesh.comm, folder / "pressed.bp", [pressed]) as writer:
    writer.write(0.0)
print(sorted(path.name for path in folder.iterdir()))

# %%
# Good to know
# ------------
#
# - Under ``mpirun`` all of this runs on many ranks. Sum what you assemble over ``mesh.comm``.
# - ``bristle.Session`` keeps mesh, matrices and factors between drops that differ only in Kn,
#   height, friction or lean.
# - ``bristle/solver/forms.py`` has the forms of the impact itself, and the theory page their
#   equations.
