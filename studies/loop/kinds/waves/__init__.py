"""Waves: strain of a bar that rings with free ends."""
