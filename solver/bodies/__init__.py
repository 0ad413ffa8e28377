"""Everything that bounces: a linear body, its rigid motion and the points where it can touch."""
