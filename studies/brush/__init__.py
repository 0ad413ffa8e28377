"""A brush: bristles clamped in a hub that is pressed on a surface and moved."""
