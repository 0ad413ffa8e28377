"""How a drop answers to stiffness, damping and effects: tables, made once and interpolated."""
