"""The hexahedral mesh of a bristle: its files, its quality, its picture."""
