"""Exceptions that a user can cause, and the exit code of each."""


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
