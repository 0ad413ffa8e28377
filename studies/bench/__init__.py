"""Measurements of the program itself: how fast it is, beside others."""
