"""Machine code of compiled functions on disk, one file for each function, argument types and processor.

A file begins with the digest of all that its code rests on and with that of its content: what is out of date, cut short
or damaged is not there, and is written over. Nothing depends on the times of files.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import uuid
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaWarning

from camber.compiled.cache_key import NotKnown, inputs_digest
from camber.compiled.compilation_progress import watchers

_DIGEST_BYTES = 32  # SHA-256
_core: Any = numba.core  # only parts of numba are typed


class MachineCodeCache(NullCache):
    """Cache that numba reads before it compiles and writes afterwards.

    Folder: NUMBA_CACHE_DIR if set, else next to the Python files, else the user's cache. Where none can be written,
    existing files are still read (a read-only image may contain them) and the rest is compiled by each process.
    """

    def __init__(self, dispatcher: Dispatcher[Any]) -> None:
        self._dispatcher = dispatcher

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code for these argument types; None if there is none that is up to date."""
        read = self._read_overload(sig, target_context)
        for progress in watchers():
            if read is None:
                progress.on_missing()
            else:
                progress.on_read()
        return read

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, in the first folder that takes it."""
        self._save_overload(sig, data)
        for progress in watchers():
            progress.on_compiled()

    def _read_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.refresh()
        named = self._named(sig, target_context.codegen())
        if named is None:
            return None
        name, digest = named
        for folder in _folders(self._dispatcher.py_func):
            content = _content(folder / name, digest)
            if content is not None:
                return _core.compiler.CompileResult._rebuild(target_context, *pickle.loads(content))
        return None

    def _save_overload(self, sig: Any, data: Any) -> None:
        named = self._named(sig, data.codegen)
        if named is None:
            return
        if data.library.has_dynamic_globals or any(not lifted.can_cache for lifted in data.lifted):
            self._warn("it has a table that is too large, or Python objects")
            return
        name, digest = named
        content = _core.serialize.dumps(data._reduce())
        content = digest + hashlib.sha256(content).digest() + content
        for folder in _folders(self._dispatcher.py_func):
            if _is_written(folder, name, content):
                break

    def _named(self, sig: Any, codegen: Any) -> tuple[str, bytes] | None:
        """Name of the file and digest of what the code in it must rest on."""
        arguments, _ = _core.sigutils.normalize_signature(sig)
        try:
            digest = inputs_digest(self._dispatcher, arguments)
        except NotKnown as error:
            self._warn(str(error))
            return None
        function = self._dispatcher.py_func
        place = repr(([str(argument) for argument in arguments], codegen.magic_tuple()))
        python = platform.python_version_tuple()
        name = f"{function.__module__}.{function.__qualname__}-py{python[0]}{python[1]}"
        name = name.replace("<", "").replace(">", "")[:150]
        return f"{name}-{hashlib.sha256(place.encode()).hexdigest()[:16]}.nbc", digest

    def _warn(self, why: str) -> None:
        function = self._dispatcher.py_func.__qualname__
        warnings.warn(f"{function} is compiled anew by each process: {why}", NumbaWarning, stacklevel=2)


def _folders(function: Any) -> list[Path]:
    source = Path(function.__code__.co_filename)
    if not source.is_file():
        return []
    source = source.absolute()
    # Files of the same name in two checkouts do not take one another's place.
    apart = f"{source.parent.name}_{hashlib.sha256(bytes(source.parent)).hexdigest()[:16]}"
    if _core.config.CACHE_DIR:
        return [Path(_core.config.CACHE_DIR) / apart]
    users = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    return [source.parent / "__pycache__", *([users / "camber" / apart] if users.is_absolute() else [])]


def _content(path: Path, digest: bytes) -> bytes | None:
    try:
        data = path.read_bytes()
    except OSError:
        return None
    head, content = data[: 2 * _DIGEST_BYTES], data[2 * _DIGEST_BYTES :]
    return content if head == digest + hashlib.sha256(content).digest() else None


def _is_written(folder: Path, name: str, content: bytes) -> bool:
    """In one step: another process sees the whole file or the one before it."""
    unfinished = folder / f"{name}.{uuid.uuid4().hex[:8]}.tmp"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        unfinished.write_bytes(content)
        unfinished.replace(folder / name)
    except OSError:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)
        return False
    return True
