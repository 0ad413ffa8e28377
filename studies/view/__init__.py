"""Pictures and animations of a result."""
