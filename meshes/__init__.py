"""Meshes of a bristle: hexahedra by gmsh, or a user's own mesh; quality checks, files."""
