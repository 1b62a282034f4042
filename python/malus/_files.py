"""Writing files so that they appear under their names only when they are complete."""

from __future__ import annotations

import errno
import fcntl
import glob
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import Any

from malus.errors import InputError, ResourceError

#: Most bytes of a name that is put together from other names; file systems allow 255, of which a name that is being written takes 30 more.
_LONGEST_NAME = 200
#: Age in seconds from which an unfinished file in a folder that several programs write to is taken to be left by one that was killed.
UNTIL_LEFT_S = 3600
#: Age in seconds from which an unlocked scratch folder is taken to be left by a writer that was killed.
_UNTIL_HELD_S = 60
_OUT_OF_SOMETHING = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.ENOMEM, errno.EFBIG)


def require_utf8(path: str | Path) -> None:
    """InputError for a path that is not UTF-8: station files, reports and the C++ library take names in UTF-8 only."""
    absolute = os.path.abspath(path)
    if not is_utf8(absolute):
        raise InputError(f"{as_text(absolute)}: this name is not in UTF-8, expected a file and folders whose names are")


def is_utf8(name: str) -> bool:
    """Whether the name of a file is valid UTF-8."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def as_text(name: str) -> str:
    """The name of a file as readable ASCII text, with all other bytes as escape sequences."""
    return os.fsencode(name).decode("ascii", "backslashreplace")


def shortened(name: str) -> str:
    """A name for a file or folder; if it is too long for file systems, its beginning and a hash of the whole."""
    whole = name.encode()
    if len(whole) <= _LONGEST_NAME:
        return name
    return f"{whole[: _LONGEST_NAME - 17].decode(errors='ignore')}_{hashlib.sha256(whole).hexdigest()[:16]}"


def natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts names as people number them: a2 before a10, whether letters are capital or not."""
    return [(int(part), "") if part.isdecimal() else (-1, part.lower()) for part in re.split(r"(\d+)", name)]


def resolved(path: str | Path) -> Path:
    """The path with all links followed; InputError in place of the other errors that Path.resolve raises."""
    try:
        return Path(path).resolve()
    except RuntimeError:
        raise InputError(f"{path}: its links go in a circle, expected one that leads to a file or a folder") from None
    except ValueError:
        raise InputError(f"{str(path)!r} has a character that no file name has") from None


def relative_path(path: Path, file: Path) -> str:
    """The path as a station file `file` names it, relative to its folder."""
    return Path(os.path.relpath(resolved(path), resolved(file).parent)).as_posix()


def with_relative_paths(text: str, folder: Path) -> str:
    """The text with paths relative to a folder where they lie in it or in a folder above it, as files that are given away name them."""
    for ups, above in enumerate([folder, *folder.parents][:-1]):
        text = re.sub(rf"(?<![^\s('\"=]){re.escape(str(above))}/", "../" * ups, text)
    return text


def open_regular(path: Path) -> BufferedReader:
    """Open a user's file for reading; OSError unless it is a regular file. A pipe could block forever, and a device may have no end."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return open(descriptor, "rb")
    is_folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
    os.close(descriptor)
    if is_folder:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, "is not a regular file", str(path))


def read_regular(path: Path) -> bytes:
    """The whole content of a regular file; OSError for any other."""
    with open_regular(path) as file:
        return file.read()


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's bytes; InputError for a file that cannot be read."""
    with reading(path), open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn errors while this file is read into InputErrors that name it."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Create the folder of `path`, and turn errors while this file is written into errors that name it."""
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
    """Give a temporary path to write to, in the same folder and with the same suffix; at the end the file is renamed to `path`.

    The name is random, so that no two writers share it, also on other machines that see the same folder.
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
    """Give an empty folder to fill, beside `folder`; at the end it is renamed to `folder`.

    InputError if `folder` exists already, or has got content when the new one is complete. With `replace` the existing folder is removed
    at the end instead.
    """
    if folder.exists() and not replace:
        raise InputError(f"{folder}: is there already, expected a new folder")
    folder = resolved(folder)  # "." has no name to put a folder beside, and a link cannot be removed as a folder.
    with writing(folder), scratch_folder(folder) as scratch:
        new = scratch / "new"
        new.mkdir()
        yield new
        if replace and folder.exists():
            shutil.rmtree(folder)
        new.rename(folder)


@contextmanager
def scratch_folder(path: Path) -> Iterator[Path]:
    """Give an empty folder beside `path`, in which its content is prepared. The folder is removed at the end.

    Folders left by writers that were killed are removed at the start. They have no lock any more: each writer locks a file in its
    folder, and the system drops the lock with the process, also for other machines that see the same folder. (On a network disk, NFS,
    the lock of a folder itself is not seen by other machines.)
    """
    for left in path.parent.glob(f".{glob.escape(path.name)}.partial-*/"):
        _remove_unless_held(left)
    scratch = path.with_name(f".{path.name}.partial-{secrets.token_hex(8)}")
    scratch.mkdir()
    held = _open_lock(scratch)
    try:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield scratch
    finally:
        _remove_and_close(scratch, held)


def _remove_unless_held(folder: Path) -> None:
    with suppress(OSError):
        # A writer locks its folder only a moment after it has made it.
        if time.time() - folder.stat().st_mtime < _UNTIL_HELD_S:
            return
        descriptor = _open_lock(folder)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
        else:
            _remove_and_close(folder, descriptor)


def _open_lock(folder: Path) -> int:
    # Writable, which NFS needs for an exclusive lock.
    return os.open(folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)


def _remove_and_close(folder: Path, lock: int) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    os.close(lock)
    # NFS keeps an open file under another name until it is closed, and the folder with it.
    shutil.rmtree(folder, ignore_errors=True)


def write_text(path: Path, text: str) -> None:
    """Write a whole text file (UTF-8)."""
    write_bytes(path, text.encode())


def write_record(path: Path, record: Mapping[str, Any]) -> None:
    """Write a JSON object with a checksum, by which `read_record` detects later changes."""
    as_read = json.loads(json.dumps(record))  # keys that are numbers become text
    write_text(path, json.dumps({**as_read, "checksum": _checksum(as_read)}, indent=1) + "\n")


def read_record(path: Path) -> dict[str, Any] | None:
    """Read what `write_record` wrote; None if the file is missing, damaged or was changed."""
    try:
        record = json.loads(read_regular(path))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(record, dict) or record.pop("checksum", None) != _checksum(record):
        return None
    return record


def _checksum(record: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def remove_unfinished(folder: Path, *, older_than_s: float, start: str = "") -> None:
    """Remove the unfinished files of killed runs from a folder, those whose finished names begin with `start`. Files younger than
    `older_than_s` stay, because other runs may be writing them now.
    """
    for path in folder.glob(f".{glob.escape(start)}*.partial-*"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > older_than_s:
                path.unlink()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)
