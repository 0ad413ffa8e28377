"""Errors meant for the user: wrong input, and a computation that failed."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py import MPI


class BristleError(Exception):
    """Base of the errors that end a command with one line and no traceback.

    ``inputs`` are the Python names of the inputs that the remedy in the message concerns; a command
    translates them into its own options.
    """

    exit_status = 1

    def __init__(self, message: str = "", *, inputs: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.inputs = inputs


class InputError(BristleError):
    """The input is wrong; the message names the input, or the file and line."""

    exit_status = 2


class ComputationError(BristleError):
    """The computation failed; the message names time, step, value, limit and what to try."""


def require(comm: MPI.Intracomm, holds: bool, message: str) -> None:
    """Raise ComputationError with one message on every rank if ``holds`` is false on any;
    collective."""
    for found in comm.allgather("" if holds else message):
        if found:
            raise ComputationError(found)
