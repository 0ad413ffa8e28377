"""Forces: what the surface feels during an impact, over time."""
