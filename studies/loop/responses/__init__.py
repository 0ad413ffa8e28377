"""Response of a drop to stiffness, damping and effects: tables, made once and interpolated."""
