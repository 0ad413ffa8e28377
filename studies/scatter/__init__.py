"""Thousands of drops that lean by chance onto a rough, composite surface."""
