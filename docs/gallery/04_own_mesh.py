"""
Your own mesh
=============

Your bristle is tapered, bent or notched. Make its mesh with gmsh, name its tip, and drop it.
"""

# %%
# The program needs four things of a mesh:
#
# - tetrahedra or hexahedra;
# - metres;
# - the z axis pointing up along the bristle;
# - a physical group called ``tip``, with the facets at the lower end that may touch.
#
# This function makes a short bristle whose upper part has a notch on either side.

import tempfile
from pathlib import Path

import gmsh
import matplotlib.pyplot as plt
import meshio
import numpy as np

import bristle

THICKNESS_M, WIDTH_M, LENGTH_M = 0.5e-3, 2.08e-3, 60e-3


def notched(path: Path, depth_m: float) -> Path:
    """Mesh a bristle with two notches of the given depth, 20 mm above the tip."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    shapes = gmsh.model.occ
    body = shapes.addBox(-THICKNESS_M / 2, -WIDTH_M / 2, 0.0, THICKNESS_M, WIDTH_M, LENGTH_M)
    if depth_m > 0.0:
        height_m, out_m = 2e-3, 1e-3
        cuts = []
        for side in (-1, 1):
            y_m = side * (WIDTH_M / 2 - depth_m) - (out_m if side < 0 else 0.0)
            cuts.append((3, shapes.addBox(-1e-3, y_m, 20e-3, 2e-3, out_m, height_m)))
        shapes.cut([(3, body)], cuts)
    shapes.synchronize()
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], name="body")
    low = [tag for _, tag in gmsh.model.getEntities(2) if on_the_ground(tag)]
    gmsh.model.addPhysicalGroup(2, low, name="tip")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 1e-3)
    gmsh.model.mesh.generate(3)
    gmsh.write(str(path))
    gmsh.finalize()
    return path


def on_the_ground(surface: int) -> bool:
    """Whether a surface of the model lies at z = 0."""
    return abs(gmsh.model.occ.getCenterOfMass(2, surface)[2]) < 1e-9


folder = Path(tempfile.mkdtemp())
meshes = {
    depth_mm: notched(folder / f"{depth_mm}.msh", 1e-3 * depth_mm) for depth_mm in (0, 0.4, 0.8)
}

# %%
# A look at the mesh before it is used:

mesh = meshio.read(meshes[0.8])
faces = np.concatenate([mesh.cells_dict["tetra"][:, np.delete(range(4), i)] for i in range(4)])
faces, count = np.unique(np.sort(faces), axis=0, return_counts=True)
skin = faces[count == 1]  # faces between two cells occur twice
_, y_mm, z_mm = 1e3 * mesh.points.T
figure, axes = plt.subplots(figsize=(8, 1.6), layout="constrained")
axes.triplot(z_mm, y_mm, skin, color="black", lw=0.4)
axes.set(xlabel="z (mm)", ylabel="y (mm)", xlim=(0, 40), aspect="equal")
plt.show()

# %%
# Drop it. The impact of a short bristle is short, so take a short time step. ``reduced`` is the
# default for a mesh of your own too. Mass, centre and inertia come from the cells, so there is no
# ``length_m`` or ``width_m`` to give.

drops = {depth: bristle.drop(mesh=path, its_s=1e-6) for depth, path in meshes.items()}
for depth_mm, drop in drops.items():
    print(
        f"notch {depth_mm:3} mm   y1/y0 {drop.rebound_ratio:.3f}   "
        f"contact {1e6 * drop.contact_time_s:.1f} µs   peak {drop.peak_force_N:.1f} N   "
        f"error of the reduction {drop.reduction_error:.0e}"
    )

# %%
# ``reduction_error`` estimates how far the reduced solid is from the full order, in units of the
# speed of impact. It is small here.
#
# The force shows the notches. Where the section narrows, a part of the wave turns round. It is back
# at the tip after 8 µs, which is 2 × 20 mm over the speed of sound. From then on it lowers the
# force:

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for depth_mm, drop in drops.items():
    first_s = drop.history.t_s[drop.history.penetration_m > 0.0].iloc[0]
    during = drop.history[(drop.history.t_s - first_s).between(-2e-6, 1.2 * drop.contact_time_s)]
    axes.plot(1e6 * (during.t_s - first_s), during.force_N, label=f"{depth_mm} mm")
axes.set(xlabel="time since first touch (µs)", ylabel="force (N)")
axes.legend(title="depth of the notches")
plt.show()

# %%
# What goes wrong most often
# --------------------------
#
# A mesh in millimetres. It is refused, and the message says so:

gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(str(meshes[0]))
gmsh.model.mesh.affineTransform([1e3, 0, 0, 0, 0, 1e3, 0, 0, 0, 0, 1e3, 0])
gmsh.write(str(folder / "millimetres.msh"))
gmsh.finalize()
try:
    bristle.drop(mesh=folder / "millimetres.msh")
except bristle.InputError as error:
    print(error)
