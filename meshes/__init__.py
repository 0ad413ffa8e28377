"""Meshes of a bristle: hexahedra by gmsh, a mesh of the user's own, quality, files."""
