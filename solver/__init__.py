"""Bodies, contact, time stepping and one drop: the mechanics, knowing nothing of meshes or studies."""
