"""Pages and figures: how they look, and how they become files."""
