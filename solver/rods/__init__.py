"""Geometrically exact rods clamped in a moving hub: statics, dynamics, contact with a plane."""
