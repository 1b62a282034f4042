"""Writing files so that they appear under their names only when they are complete."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from malus.errors import InputError, ResourceError

_OUT_OF_SOMETHING = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.ENOMEM, errno.EFBIG)


def require_utf8(path: str | Path) -> None:
    """InputError for a path that is no text: station files, reports and the C++ library take names in UTF-8 only."""
    absolute = os.path.abspath(path)
    try:
        absolute.encode()
    except UnicodeEncodeError:
        shown = os.fsencode(absolute).decode("ascii", "backslashreplace")
        raise InputError(f"{shown}: this name is not in UTF-8, expected a file and folders whose names are") from None


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's bytes. InputError for one that cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn failures of writing this file into errors that name it; makes its folder."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        if isinstance(error, InputError | ResourceError):
            raise
        kind = ResourceError if error.errno in _OUT_OF_SOMETHING else InputError
        raise kind(f"{path}: cannot be written ({error.strerror or error})") from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary name in the same folder, with the same ending, to write to; at the end it becomes `path`.

    No two writers share one, on this machine or another that sees the same folder.
    """
    temporary = path.with_name(f".{path.stem}.partial-{secrets.token_hex(8)}{path.suffix}")
    with writing(path):
        try:
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def new_folder(folder: Path, *, replace: bool = False) -> Iterator[Path]:
    """Give an empty folder to fill, beside the place of `folder`; at the end it becomes `folder`.

    InputError if that is there already, unless it may be replaced: then it is removed at the end.
    """
    if folder.exists() and not replace:
        raise InputError(f"{folder}: is there already, expected a new folder")
    with writing(folder), tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as scratch:
        new = Path(scratch) / "new"
        new.mkdir()
        yield new
        if folder.exists():
            shutil.rmtree(folder)
        new.rename(folder)


def write_text(path: Path, text: str) -> None:
    """Write a whole text file (UTF-8)."""
    write_bytes(path, text.encode())


def write_record(path: Path, record: Mapping[str, Any]) -> None:
    """Write a JSON object with a checksum, by which `read_record` knows that nobody changed it."""
    as_read = json.loads(json.dumps(record))  # keys that are numbers become text
    write_text(path, json.dumps({**as_read, "checksum": _checksum(as_read)}, indent=1) + "\n")


def read_record(path: Path) -> dict[str, Any] | None:
    """What `write_record` wrote; None if there is none, or not as it was written."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(record, dict) or record.pop("checksum", None) != _checksum(record):
        return None
    return record


def _checksum(record: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def remove_unfinished(folder: Path, *, older_than_s: float) -> None:
    """Remove files in a folder that a run which was killed had begun to write. Others may write there: what is younger
    than that stays.
    """
    for path in folder.glob(".*.partial-*"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > older_than_s:
                path.unlink()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)
