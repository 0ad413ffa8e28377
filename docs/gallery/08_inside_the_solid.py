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
# The full solid writes its fields when ``out`` names a folder. ``until="impact"`` stops after the
# first impact, and ``write_every=2`` keeps every second step. A shorter time step makes the wave
# sharp.

import tempfile
from pathlib import Path

import adios2
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import ufl
from dolfinx import fem, io
from dolfinx.fem.petsc import LinearProblem
from mpi4py import MPI

import bristle
from bristle.meshes.distribute import to_dolfinx
from bristle.meshes.geometry import MeshSpec, Tag
from bristle.solver import paper

CELLS = (1, 2, 120)
folder = Path(tempfile.mkdtemp())
drop = bristle.drop(
    model="solid", cells=CELLS, kn_N_m=1e7, its_s=1e-6, until="impact", write_every=2, out=folder
)
print(drop)

# %%
# Read the fields
# ---------------
#
# ``fields/solid.bp`` is a series of ADIOS2 steps. ParaView opens it (``bristle view`` writes a
# script for that), and so does Python. ``frames.csv`` has the time of every step. Take the axial
# stress and average it over each height:

frames = pd.read_csv(folder / "fields" / "frames.csv")
stress_Pa = []
with adios2.FileReader(str(folder / "fields" / "solid.bp")) as file:
    height_m = np.round(file.read("geometry")[:, 2], 7)
    levels_m, level = np.unique(height_m, return_inverse=True)
    for step in range(file.num_steps()):
        values = file.read("axial_stress_Pa", step_selection=[step, 1]).ravel()
        stress_Pa.append(np.bincount(level, values) / np.bincount(level))

# %%
# The wave in one picture: time to the right, height upward, blue is compression. It runs up with
# the speed of sound √(E/ρ). The free end turns it into a wave of tension, which cancels the
# compression on its way down. The dashed line is a path with the speed of sound.

time_us = 1e6 * (frames.t_s - frames.t_s.iloc[0])
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
# The same mesh for your own forms
# --------------------------------
#
# ``to_dolfinx`` makes the program's mesh, with tags for the tip, the top and the side. From here on
# this is plain FEniCSx. As an example, press the bristle slowly: hold its top, push its tip by a
# force F, and ask how stiff it is.

mesh, _, facets = to_dolfinx(MeshSpec(cells=CELLS), MPI.COMM_SELF)
space = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
u, w = ufl.TrialFunction(space), ufl.TestFunction(space)

nu = paper.POISSON
lame = paper.YOUNGS_PA * nu / ((1 + nu) * (1 - 2 * nu))
shear = paper.YOUNGS_PA / (2 * (1 + nu))


def stress(displacement):
    """Hooke's law."""
    strain = ufl.sym(ufl.grad(displacement))
    return lame * ufl.tr(strain) * ufl.Identity(3) + 2 * shear * strain


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

with io.VTXWriter(mesh.comm, folder / "pressed.bp", [pressed]) as writer:
    writer.write(0.0)
print(sorted(path.name for path in folder.iterdir()))

# %%
# Good to know
# ------------
#
# - Under ``mpirun`` all of this runs on many ranks. Give ``to_dolfinx`` your communicator.
# - ``bristle.Session`` keeps mesh, matrices and factors between drops that differ only in Kn,
#   height, friction or lean.
# - ``bristle/solver/forms.py`` has the forms of the impact itself, and the theory page their
#   equations.
