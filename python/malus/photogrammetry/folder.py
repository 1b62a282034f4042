"""The folder in which one process at a time keeps the front end's files."""

from __future__ import annotations

import fcntl
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from malus.errors import ExternalError, InputError, MalusError, ResourceError, kind_of

#: SQLite's codes for failures of the system, such as a full disk; the database itself is undamaged.
_OF_SYSTEM = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR)


@contextmanager
def exclusive(folder: Path, *, wait: bool = False) -> Iterator[None]:
    """Create the folder if needed and hold it for this process.

    If another process holds the folder, raises InputError, or waits for that process if `wait` is set. Failures of the
    system in the `with` block, also below a database, become InputError for paths that cannot be used, else ResourceError; those
    of a damaged database become ExternalError.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                raise InputError(
                    f"{folder} is in use by another process; wait for it, or choose another folder"
                ) from None
            try:
                yield
            finally:
                # Closing alone leaves the folder locked while a child that was forked meanwhile has the file open, too.
                fcntl.flock(lock, fcntl.LOCK_UN)
    except MalusError:
        raise
    except OSError as error:
        raise kind_of(error)(f"{error.filename or folder}: {error.strerror or error}") from None
    except sqlite3.Error as error:
        # The lower byte is the kind of failure. Errors of the module sqlite3 itself have no code.
        if getattr(error, "sqlite_errorcode", 0) & 0xFF in _OF_SYSTEM:
            raise ResourceError(f"{folder}: COLMAP's database cannot be read or written: {error}") from None
        raise ExternalError(
            f"{folder}: COLMAP's database is damaged ({error}); remove the folder and run again"
        ) from None
