"""The folder in which one process at a time keeps the front end's files."""

from __future__ import annotations

import fcntl
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from malus.errors import ExternalError, InputError, MalusError, kind_of


@contextmanager
def exclusive(folder: Path, *, wait: bool = False) -> Iterator[None]:
    """Create the folder if needed and hold it for this process.

    If another process holds the folder, raises InputError, or waits for that process if `wait` is set. Failures of the
    system in the `with` block become InputError for paths that cannot be used, else ResourceError; those of a damaged database
    become ExternalError.
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
        raise ExternalError(
            f"{folder}: COLMAP's database is damaged ({error}); remove the folder and run again"
        ) from None
