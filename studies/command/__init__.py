"""The command line: its options, how a command ends, a study as a script."""
