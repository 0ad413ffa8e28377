"""From films of drops to tracks of the lower tip."""
