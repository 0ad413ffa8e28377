"""What the studies take: fields with units and bounds, their limits, and where values come from."""
