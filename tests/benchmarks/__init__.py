"""Benchmarks of this program, which `bristle bench` runs: records, their table and their page."""
