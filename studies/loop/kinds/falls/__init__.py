"""Falls: proper acceleration of a body in free fall."""
