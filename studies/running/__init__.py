"""How cases are computed: over ranks, once each, kept, and taken up again."""
