"""`bristle track`: films of drops into a dataset of tracks."""
