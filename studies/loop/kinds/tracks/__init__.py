"""Tracks: films of a body that falls and bounces."""
