"""Exceptions for failures that a user can meet, and the exit code of each."""

from __future__ import annotations

import errno

#: Errors of the system about a path that somebody gave. All others mean that disk, memory or processes are lacking.
_OF_PATHS = (
    errno.ENOENT, errno.EACCES, errno.EPERM, errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ENAMETOOLONG, errno.ELOOP,
    errno.EROFS,
)  # fmt: skip


class MalusError(Exception):
    """Base of all errors raised by malus; `exit_code` is what the command line returns for it."""

    exit_code = 1


class InputError(MalusError, ValueError):
    """A file, field, value or command line is wrong; the message says which and what was expected."""

    exit_code = 2


class DataError(MalusError, RuntimeError):
    """The data cannot support a result: too few angles, no overlap with the prior, …"""

    exit_code = 3


class ExternalError(MalusError, RuntimeError):
    """An external program is missing or failed."""

    exit_code = 4


class ResourceError(MalusError, OSError):
    """Out of disk or memory."""

    exit_code = 5


def error_of(exit_code: int) -> type[MalusError]:
    """The class of error with this exit code; DataError for a code that no class has."""
    kinds = (InputError, DataError, ExternalError, ResourceError)
    return next((kind for kind in kinds if kind.exit_code == exit_code), DataError)


def kind_of(error: OSError) -> type[MalusError]:
    """The class for an error of the system: InputError if a path cannot be used, else ResourceError."""
    return InputError if error.errno in _OF_PATHS else ResourceError


def ending_of(error: Exception) -> tuple[int, str]:
    """Exit code and message for any exception that ends a run, so that no user sees a traceback."""
    if isinstance(error, MalusError):
        return error.exit_code, str(error)
    # The ImportError: a library for which there was no memory when it was loaded.
    if isinstance(error, MemoryError) or (isinstance(error, ImportError) and "failed to map segment" in str(error)):
        return ResourceError.exit_code, "out of memory; see `malus check` for what the station needs"
    if isinstance(error, OSError):
        return kind_of(error).exit_code, f"{error.filename or 'a file'}: {error.strerror or error}"
    return (
        ResourceError.exit_code,
        f"stopped by an error of its own, please report it: {type(error).__name__}: {error}\n"
        "  (set MALUS_TRACEBACK=1 to see where)",
    )
