"""Contact stiffness from measured drops."""
