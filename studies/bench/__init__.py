"""Measurements of the program itself: how often it is right, and how fast."""
