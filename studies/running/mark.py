"""A folder of results: a mark of what the program wrote there, and a lock while a run writes.

It replaces and removes nothing else there.

The file `MARK` in a folder of results names each file that the program wrote into it, with a
digest. A file is the program's own while it is as it was written: one that the user edited, or put
in its place, is the user's. What grows while a run goes on is named without a digest.

A file is named before it takes its place, so that a run killed in between leaves nothing that the
next one takes for the user's.

The ranks of an mpirun that was killed compute on until they next talk to each other, and would put
what they find among what their successor does. A lock on the folder, which the system gives up with
the process that holds it, keeps one behind the other. Libraries of locks lock a file of their own,
which would have to lie among the results, or elsewhere for all machines that see the folder.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import tempfile
import time
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Self

from ...solver.errors import InputError
from .progress import note

MARK, SCHEMA = "written-by-bristle.json", "bristle-written-1"
ABOUT = "bristle wrote these files. It replaces them, and no others, when it writes here again."
FOREIGN = "was not written by this program"
CHANGED = "has changed since this program wrote it"
# How the names of things begin until they are whole.
UNFINISHED = ".bristle-unfinished-"
# Of a file, for its digest: long series of fields take no time then.
DIGESTED = 1 << 26
PATIENCE_S, AGAIN_S = 120.0, 0.1
# What file systems say that know no locks.
UNKNOWN = (errno.ENOLCK, errno.ENOTSUP, errno.EBADF, errno.EINVAL, errno.ENOSYS)


def refuse_foreign(folder: Path, *names: str) -> None:
    """InputError about the first of ``names`` in ``folder`` that is there and not the program's.

    A name that ends in a slash is a folder's. One that the program made, or that is empty, may be
    written into, and what the user added to it stays.
    """
    mark = Mark.read(folder)
    for name in names:
        mark.check(name)


def claim(folder: Path, *names: str) -> None:
    """Name what is about to grow in ``folder``, and forget what is not there any more."""
    mark = Mark.read(folder)
    mark.forget_missing()
    mark.growing |= set(names)
    mark.write()


@dataclass
class Mark:
    """What the program wrote into ``folder``: digests by the name of each file, of which one is the
    present content's, and the names of what is ``growing``."""

    folder: Path
    files: dict[str, list[str]] = field(default_factory=dict)
    growing: set[str] = field(default_factory=set)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The mark in ``folder``, an empty one where there is none; InputError where it is none."""
        path = folder / MARK
        if not os.path.lexists(path):
            return cls(folder)
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            if path.is_symlink() or document["schema"] != SCHEMA:
                raise ValueError
            files = {name: list(each) for name, each in document["files"].items() if _inside(name)}
            return cls(folder, files, set(filter(_inside, document["growing"])))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise _refusal(path, "is not as this program writes it") from None

    def own(self, name: str) -> bool:
        """Whether the file ``name`` is there as the program wrote it, and behind no link."""
        path = self.folder / name
        if not path.is_file() or self._linked(name):
            return False
        return name in self.growing or digest(path) in self.files.get(name, ())

    def check(self, name: str) -> None:
        """InputError where ``name``, of a file or folder/, is there and not the program's."""
        path = self.folder / name
        if self._linked(name):
            raise _refusal(path, "is behind a symbolic link, which this program did not make")
        if not os.path.lexists(path):
            return
        if name.endswith("/") and path.is_dir():
            inside = [each for each in self.files if each.startswith(name)]
            if not inside and name not in self.growing and any(path.iterdir()):
                raise _refusal(path, FOREIGN)
            for each in inside:
                self.check(each)
        elif name.endswith("/") or not self.own(name):
            raise _refusal(path, CHANGED if name in self.files and path.is_file() else FOREIGN)

    def _linked(self, name: str) -> bool:
        parts = PurePosixPath(name)
        return any((self.folder / each).is_symlink() for each in (parts, *parts.parents[:-1]))

    def below(self, paths: Iterable[Path]) -> list[str]:
        """The files that are, or lie in, one of ``paths`` and are as they were written."""
        inside = [path.relative_to(self.folder) for path in paths]
        return [
            name
            for name in self.files
            if any(PurePosixPath(name).is_relative_to(each) for each in inside) and self.own(name)
        ]

    def add(self, digests: dict[str, str]) -> None:
        """Name files with the digests of what they are about to hold, beside what they hold now."""
        self.forget_missing(but=digests)
        for name in digests.keys() - self.growing:
            now = digest(self.folder / name)
            self.files[name] = [digests[name], now] if now else [digests[name]]

    def forget_missing(self, but: Container[str] = ()) -> None:
        """Forget what is not there any more, unless it is about to be."""
        every = (*self.files, *self.growing)
        there = {each for each in every if each in but or (self.folder / each).exists()}
        self.files = {name: each for name, each in self.files.items() if name in there}
        self.growing &= there

    def write(self) -> None:
        """Put it into its folder; OSError."""
        document = {
            "schema": SCHEMA,
            "about": ABOUT,
            "files": dict(sorted(self.files.items())),
            "growing": sorted(self.growing),
        }
        write_whole(self.folder / MARK, json.dumps(document, indent=2) + "\n")


def _inside(name: str) -> bool:
    """Whether a name stays within its folder."""
    return ".." not in PurePosixPath(name).parts and not name.startswith("/")


def _refusal(path: Path, why: str) -> InputError:
    return InputError(f"{path}: {why}; move it away, or choose another --out")


def digest(path: Path) -> str:
    """Of a file's length and its first `DIGESTED` bytes; empty where it cannot be read."""
    try:
        with path.open("rb") as file:
            found = hashlib.sha256(f"{os.fstat(file.fileno()).st_size} ".encode())
            found.update(file.read(DIGESTED))
    except OSError:
        return ""
    return found.hexdigest()[:32]


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file beside ``path``, see it on the disk, then give it its name; OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=path.parent) as beside:
        made = Path(beside, path.name)
        write_out(made, content)
        made.replace(path)


def write_out(path: Path, content: str | bytes) -> None:
    """Write a file and see it on the disk; OSError."""
    with path.open("wb") as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        os.fsync(file.fileno())


# Folders that a command holds, and their descriptors; None outside of commands.
_held: dict[Path, int] | None = None


@contextmanager
def locks() -> Iterator[None]:
    """A command: the folders that it locked are free again at its end."""
    global _held
    outer, _held = _held, {}
    try:
        yield
    finally:
        for descriptor in _held.values():
            os.close(descriptor)
        _held = outer


def lock_folder(folder: Path) -> None:
    """Wait until no other run writes into ``folder``, and keep others out until the command ends.

    Raises InputError where another goes on for ``PATIENCE_S``, OSError where it cannot be opened.
    """
    place = folder.resolve()
    if _held is None or place in _held:
        return
    descriptor = os.open(place, os.O_RDONLY | os.O_DIRECTORY)
    try:
        _wait(descriptor, folder)
    except BaseException:
        os.close(descriptor)
        raise
    _held[place] = descriptor


def _wait(descriptor: int, folder: Path) -> None:
    until, announced = time.monotonic() + PATIENCE_S, False
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() > until:
                raise InputError(f"--out {folder}: another run is writing there") from None
        except OSError as error:
            if error.errno in UNKNOWN:
                return
            raise
        if not announced:
            note(f"waiting for another run that writes into {folder} …")
            announced = True
        time.sleep(AGAIN_S)
