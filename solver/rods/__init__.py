"""Geometrically exact rods clamped in a moving hub, which touch a surface and each other."""
