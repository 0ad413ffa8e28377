"""Effects: named pieces of physics that a first model lacks."""
