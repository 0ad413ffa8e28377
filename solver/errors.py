"""Which errors a user is meant to see: wrong input, and a computation that failed."""


class BristleError(Exception):
    """Base of the errors that end a command with one line and no traceback."""

    exit_status = 1


class InputError(BristleError):
    """The input is wrong; the message names the option, or the file and line."""

    exit_status = 2


class ComputationError(BristleError):
    """The computation failed; the message names time, step, value, limit and what to try."""
