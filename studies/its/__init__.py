"""The integration time step that each quantity needs."""
