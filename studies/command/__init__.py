"""The command line: options, where values come from, limits, and how a command ends."""
