"""Compilation of numerical code by Numba, and the cache of the compiled code.

Numba stores compiled functions on disk, but decides by a function's own file alone whether they are
out of date. The cache folder is therefore named after all sources that compiled code may use.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import hashlib
import logging
import operator
import os
import shutil
import stat
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Protocol, cast

import numba
from numba.core import caching, cgutils, types
from numba.core.runtime import rtsys
from numba.core.types import WrapperAddressProtocol
from numba.core.typing import Signature
from numba.core.typing.typeof import Purpose, typeof
from numba.experimental import function_type  # noqa: F401, which lets `Pointer` be an argument
from numba.extending import intrinsic

LOG = logging.getLogger("bristle")
KEPT_S = 7 * 86400.0
# Folders of the package that compiled code does not use.
APART = ("effects",)


class Decorator(Protocol):
    """A decorator that preserves a function's signature."""

    def __call__[Function](self, function: Function) -> Function: ...


@cache
def cache_folder() -> Path:
    """The folder for this version of the sources, see `writable_folder`.

    It is determined once, since a process' output belongs to the sources it started with.
    """
    folder = writable_folder("compiled", version_of(Path(__file__).parent))
    _forget_old(folder)
    return folder


def version_of(sources: Path) -> str:
    """A digest of the package's sources that compiled code may use."""
    digest = hashlib.sha256()
    for path in sorted(sources.rglob("*.py")):
        if path.relative_to(sources).parts[0] not in APART:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def writable_folder(kind: str, name: str = "") -> Path:
    """The user's folder ``name`` of a ``kind``, in the user's cache or, failing that, in /tmp.

    Its contents are executed as code. So it, and the folders created above it, must belong to the
    user and be writable by nobody else. Otherwise the folder is private to this process.
    """
    home = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    uid, temporary = os.getuid(), Path(tempfile.gettempdir())
    places = (
        (Path(home) if home else Path.home() / ".cache", Path("bristle", f"{kind}-{uid}", name)),
        (temporary, Path(f"bristle-{uid}", kind, name)),
    )
    for root, inside in places:
        folder = root / inside
        try:
            root.mkdir(parents=True, exist_ok=True)
            made = (root / each for each in (*reversed(inside.parents[:-1]), inside))
            open_to_others = next((each for each in made if not _made_private(each)), None)
            if open_to_others is not None:
                LOG.warning(
                    "%s is no cache that is safe to use, so code is compiled anew: it must be your "
                    "own folder, and writable for you alone; remove it, or chmod go-w it",
                    open_to_others,
                )
                continue
            tempfile.TemporaryFile(dir=folder).close()  # fails if read-only, also for root
        except OSError:
            continue
        return folder
    return process_folder(kind, name)


def _made_private(folder: Path) -> bool:
    """Create ``folder`` if missing; whether nobody else can have written into it."""
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    mine = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
    return mine and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def process_folder(kind: str, name: str = "") -> Path:
    """A folder that is removed with this process."""
    root = Path(tempfile.mkdtemp(prefix="bristle-"))
    atexit.register(shutil.rmtree, root, ignore_errors=True)
    folder = root / kind / name
    folder.mkdir(parents=True)
    return folder


def _forget_old(folder: Path) -> None:
    """Remove caches that no process has started with for a week."""
    folder.touch()
    for path in folder.parent.iterdir():
        if time.time() - path.stat().st_mtime > KEPT_S:
            shutil.rmtree(path, ignore_errors=True)


class _Index(caching.IndexDataCacheFile):
    """Numba's index of a function's compiled versions, locked against other processes.

    Two processes that compile for different types at once would give both versions the same file,
    and a third process would load the wrong code.
    """

    def save(self, key: Any, data: Any) -> None:
        with (cache_folder() / "lock").open("w") as file:
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX)
            super().save(key, data)


class _InThePackage(caching._CacheLocator):
    """Cache location of a function by its place in this package, wherever the package is installed.

    Numba uses the folder and the date of a file, so a clone or an installation of the same sources
    would compile everything again.
    """

    def __init__(self, function: Callable[..., Any], path: Path) -> None:
        self._line, self._path = function.__code__.co_firstlineno, path

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> _InThePackage | None:
        path, sources = Path(file), Path(__file__).parent
        if not path.is_relative_to(sources) or path.relative_to(sources).parts[0] in APART:
            return None
        return cls(function, path.relative_to(sources))

    def get_cache_path(self) -> str:
        return str(cache_folder() / self._path.parent)

    def get_source_stamp(self) -> str:
        return ""  # the name of the cache folder identifies the sources

    def get_disambiguator(self) -> str:
        return str(self._line)


def _load_overload(kept: Any, signature: Signature, target: Any) -> Any:
    """Machine code from the cache, without Numba's initialisation of all that it can compile.

    That takes a fifth of a second; Numba does it itself before it compiles anything.
    """
    rtsys.initialize(target)
    return kept._load_overload(signature, target)


numba.config.CACHE_DIR = str(cache_folder())
caching.CacheImpl._locator_classes.insert(0, _InThePackage)
caching.IndexDataCacheFile = _Index
caching.Cache.load_overload = _load_overload

njit = cast(Decorator, numba.njit(cache=True, nogil=True))
# For functions that call Python. They acquire its lock themselves, so nogil is not set.
with_python = cast(Decorator, numba.njit(cache=True))
# For small functions of many arrays, which are costly to pass.
inlined = cast(Decorator, numba.njit(cache=True, nogil=True, forceinline=True))
# For large functions called only by compiled code, in one place: they are inlined, and not compiled
# separately for Python.
within = cast(
    Decorator,
    numba.njit(
        cache=True, nogil=True, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True
    ),
)
# Sums may be reordered, so that long ones are vectorised.
fast = cast(Decorator, numba.njit(cache=True, nogil=True, fastmath=True))


@intrinsic
def unowned(_context: Any, record: Any) -> Any:
    """Arrays, or records of them, without reference counting.

    Numba counts references to an array by atomic operations. In loops over small views these cost a
    quarter of the time or more. Use this for arrays from Python, which owns them during the call.
    Also use it for arrays that compiled code makes and holds in another record until the last view
    is used; otherwise they would be freed too early.
    """

    def without(context: Any, builder: Any, of: Any, value: Any) -> Any:
        array = context.make_array(of)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        return array._getvalue()

    def write(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _of_arrays(context, builder, record, record, arguments[0], without)

    return record(record), write


def _of_arrays(
    context: Any, builder: Any, made: Any, of: Any, value: Any, act: Callable[..., Any]
) -> Any:
    """A record of type ``made``, with ``act`` applied to each array of the original."""
    if isinstance(of, types.BaseTuple):
        each = [
            _of_arrays(context, builder, to, one, builder.extract_value(value, k), act)
            for k, (to, one) in enumerate(zip(made, of, strict=True))
        ]
        return context.make_tuple(builder, made, each)
    return act(context, builder, of, value) if isinstance(of, types.Array) else value


@intrinsic
def _nth(_context: Any, record: Any, i: Any) -> Any:
    """See `nth`."""

    def row(of: Any) -> Any:
        if isinstance(of, types.BaseTuple):
            return types.BaseTuple.from_types([row(each) for each in of], of.instance_class)
        if isinstance(of, types.Array):
            # a row of an array in Fortran order is not contiguous
            layout = "C" if of.layout == "C" else "A"
            return of.copy(ndim=of.ndim - 1, layout=layout) if of.ndim > 1 else of.dtype
        return of

    def write(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def at(context: Any, builder: Any, of: Any, value: Any) -> Any:
            take = context.get_function(operator.getitem, row(of)(of, signature.args[1]))
            return take(builder, (value, arguments[1]))

        return _of_arrays(context, builder, row(record), record, arguments[0], at)

    return row(record)(record, i), write


@njit
def nth[Record](stack: Record, i: int) -> Record:
    """Entry ``i`` of a stack: a record of the views of row ``i`` of each array."""
    return _nth(stack, i)


@intrinsic
def _write(_context: Any, source: Any, into: Any) -> Any:
    """See `write`."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        def each(one: Any, other: Any, value: Any, place: Any) -> None:
            if isinstance(one, types.BaseTuple):
                for k, (a, b) in enumerate(zip(one, other, strict=True)):
                    each(a, b, builder.extract_value(value, k), builder.extract_value(place, k))
            else:
                context.compile_internal(builder, _entries, types.none(one, other), (value, place))

        each(source, into, *arguments)
        return context.get_dummy_value()

    return types.none(source, into), code


def _entries(source: Any, into: Any) -> None:
    # a slice would take Numba ten times as long to compile
    entries, places = source.ravel(), into.ravel()
    for k in range(len(places)):
        places[k] = entries[k]


@njit
def write[Record](source: Record, into: Record) -> None:
    """Fill one contiguous array with the first entries of another, or each array in a record with
    those of the array in another record."""
    _write(source, into)


class Pointer(WrapperAddressProtocol):
    """A function that compiled code calls by its address.

    So its caller is compiled once for all functions of this ``signature``. The function is compiled
    where it is first passed, and cached on disk unless it comes from outside the package.
    """

    def __init__(self, function: Callable[..., Any], signature: Signature) -> None:
        self.function = getattr(function, "py_func", function)  # it may be compiled already
        self._signature = signature

    @cached_property
    def _compiled(self) -> Any:
        own = self.function.__module__.startswith(f"{__package__}.")
        return numba.cfunc(self._signature, cache=own)(self.function)

    def __wrapper_address__(self) -> int:
        return int(self._compiled.address)

    def signature(self) -> Signature:
        return self._signature


_TURN = threading.Lock()
_THREAD = threading.local()


@contextlib.contextmanager
def in_turn() -> Iterator[None]:
    """Hold this thread's turn: other threads run while it is in `meanwhile`.

    For threads that call compiled functions. If two of them meet new argument types at once Numba
    aborts, since its table of types is not thread-safe.
    """
    with _TURN:
        _THREAD.has_turn = True
        try:
            yield
        finally:
            _THREAD.has_turn = False


def has_turn() -> bool:
    """Whether this thread has its turn."""
    return bool(getattr(_THREAD, "has_turn", False))


def meanwhile(function: Callable[..., Any], *arguments: Any) -> Any:
    """Result of the compiled ``function``; other threads have their turn while it computes."""
    if not has_turn():
        return function(*arguments)
    # determined here, so that nothing needs to be looked up outside the turn
    types = tuple(typeof(each, Purpose.argument) for each in arguments)
    machine_code = cast(Any, function).compile(types)
    _TURN.release()
    try:
        return machine_code(*arguments)
    finally:
        _TURN.acquire()
