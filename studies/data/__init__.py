"""Datasets: folders of measurements."""
