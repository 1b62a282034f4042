"""Exceptions that a user can cause, and the exit code of each."""

from __future__ import annotations


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
    """The kind of error that ends with an exit code; DataError for those of none."""
    kinds = (InputError, DataError, ExternalError, ResourceError)
    return next((kind for kind in kinds if kind.exit_code == exit_code), DataError)


def ending_of(error: Exception) -> tuple[int, str]:
    """Exit code and message for whatever ends a run: the last net, so that nobody is shown a traceback."""
    if isinstance(error, MalusError):
        return error.exit_code, str(error)
    # A library that finds no room when it is loaded.
    if isinstance(error, MemoryError) or (isinstance(error, ImportError) and "failed to map segment" in str(error)):
        return ResourceError.exit_code, "out of memory; see `malus check` for what the station needs"
    if isinstance(error, OSError):
        return ResourceError.exit_code, f"{error.filename or 'a file'}: {error.strerror or error}"
    return (
        ResourceError.exit_code,
        f"stopped by an error of its own, please report it: {type(error).__name__}: {error}\n"
        "  (set MALUS_TRACEBACK=1 to see where)",
    )
