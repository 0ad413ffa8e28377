"""Bodies, contact, time stepping and one drop: the mechanics, apart from meshes and studies."""
