"""The loop: from measurements to the effect that the model lacks."""
