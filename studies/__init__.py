"""What people run: a drop, sweeps, meshes, each a page of the paper, and the `bristle` command."""

__version__ = "0.1.0"
