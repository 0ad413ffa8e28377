"""Which errors a user is meant to see: wrong input, and a computation that failed."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py import MPI


class BristleError(Exception):
    """Base of the errors that end a command with one line and no traceback.

    ``inputs`` are the inputs that the remedy in the message is about, by their names in Python; a
    command says how they are called there.
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
    """ComputationError on every rank, with one message, where something does not hold on one;
    collective."""
    for found in comm.allgather("" if holds else message):
        if found:
            raise ComputationError(found)
