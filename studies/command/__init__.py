"""The command line: options of typer, how a command ends, a study as a script."""
