"""Drops: heights before and after, contact times and peak forces."""
