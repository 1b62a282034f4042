"""Starts, watches, logs and ends COLMAP as a child process.

COLMAP is the program `colmap`, or the package pycolmap behind the same commands (pycolmap_driver).
"""

from __future__ import annotations

import importlib.util
import os
import re
import selectors
import shutil
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path

from malus.errors import ExternalError
from malus.photogrammetry import memory

#: Name of the program, or the path that the environment variable MALUS_COLMAP gives.
DEFAULT_PROGRAM = "colmap"
#: Package that can replace the program, and the script that runs the package.
PACKAGE = "pycolmap"
_DRIVER = Path(__file__).with_name("pycolmap_driver.py")
_MIN_PACKAGE_VERSION = (4, 2)
_GET_PROGRAM = "apt install colmap (Debian and Ubuntu)"
_GET_PACKAGE = "pip install 'malus[pycolmap]'"
_POLL_S = 0.2
_GRACE_S = 3.0
_TAIL_LINES = 5
#: Lines of a stack trace; they follow the line that names the failed check.
_STACK_TRACE = re.compile(r"\s*@ |\*\*\* |\s*$")


class SearchStoppedError(Exception):
    """The child was ended because `keep_going` returned False."""


def as_colmap_3(line: str) -> str:
    """A progress line of COLMAP 4 in the wording of 3.8, which is parsed here."""
    line = line.replace("Processing block [", "Matching block [")
    # 3.8 counts the image that is being registered, 4 does not.
    return re.sub(r"\(num_reg_frames=(\d+)\)", lambda match: f"({int(match[1]) + 1})", line)


class Colmap:
    """The COLMAP that is installed on this machine."""

    def __init__(self, threads: int, backend: str = "auto") -> None:
        """Find the COLMAP that `backend` (an option of [photos]) selects. Raises ExternalError if it is missing or does not start."""
        self.threads = threads
        self.peak_mb = 0.0
        """Most memory of a child and of this process beside it, since this was set to 0."""
        self.backend, self._start = _find(backend)
        self.version = self._read_version()

    @property
    def title(self) -> str:
        """Name and version, for reports and the marks of finished stages."""
        return f"COLMAP {self.version}" + (f" ({PACKAGE})" if self.backend == PACKAGE else "")

    def _read_version(self) -> str:
        name = PACKAGE if self.backend == PACKAGE else self._start[0]
        try:
            answer = subprocess.run(
                [*self._start, "help"],
                capture_output=True,
                encoding="utf-8",
                errors="replace",
                timeout=60,
                env=self._environment(),
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ExternalError(f"{name} does not start: {error}") from None
        match = re.search(r"COLMAP ((\d+)\.(\d+)[\w.]*)", answer.stdout)
        if match is None and self.backend == PACKAGE:
            last = (answer.stderr.strip() or f"exit code {answer.returncode}").splitlines()[-1]
            raise ExternalError(f"the package {PACKAGE} does not start: {last}; {_GET_PACKAGE}, or {_GET_PROGRAM}")
        if match is None:
            raise ExternalError(f"{name} does not say which COLMAP it is, expected `colmap help` to name its version")
        if self.backend == PACKAGE and (int(match[2]), int(match[3])) < _MIN_PACKAGE_VERSION:
            least = ".".join(map(str, _MIN_PACKAGE_VERSION))
            raise ExternalError(f"the package {PACKAGE} is {match[1]}, expected {least} or later; {_GET_PACKAGE}")
        return match[1]

    def _environment(self) -> dict[str, str]:
        # Qt must not look for a display; BLAS threads would come on top of COLMAP's own.
        return {**os.environ, "QT_QPA_PLATFORM": "offscreen", "LC_ALL": "C.UTF-8", "OPENBLAS_NUM_THREADS": "1",
                "OMP_NUM_THREADS": str(self.threads)}  # fmt: skip

    def run(
        self,
        command: str,
        arguments: Mapping[str, object],
        log: Path,
        *,
        on_line: Callable[[str], None] | None = None,
        keep_going: Callable[[], bool] | None = None,
        working_folder: Path | None = None,
    ) -> None:
        """Run COLMAP's COMMAND with `--key value …`. Its output goes to the file `log` and line by line to `on_line`.

        Raises ExternalError with the last lines of the output if the command fails, and SearchStoppedError if `keep_going` returned
        False. Ctrl-C, or any error here, ends the child with all processes that it started.
        """
        words = [*self._start, command]
        for key, value in arguments.items():
            words += [f"--{key}", str(int(value) if isinstance(value, bool) else value)]
        setpriv = shutil.which("setpriv")
        if setpriv is not None:  # The child ends with this process, even if this is killed.
            words = [setpriv, "--pdeathsig", "TERM", *words]
        log.parent.mkdir(parents=True, exist_ok=True)
        tail: deque[str] = deque(maxlen=_TAIL_LINES)
        with log.open("ab") as log_file:
            log_file.write((" ".join(words) + "\n").encode())
            log_file.flush()
            child = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=self._environment(),
                cwd=working_folder,
            )
            try:
                code = self._watch(child, log_file.write, tail, on_line, keep_going)
            except BaseException:
                _end(child)
                raise
        if code != 0:
            how = f"was ended by signal {-code}" if code < 0 else f"failed with exit code {code}"
            last = " / ".join(tail)
            raise ExternalError(f"{self.backend} {command} {how}: {last or 'it said nothing'} (all of it is in {log})")

    def _watch(
        self,
        child: subprocess.Popen[bytes],
        write: Callable[[bytes], object],
        tail: deque[str],
        on_line: Callable[[str], None] | None,
        keep_going: Callable[[], bool] | None,
    ) -> int:
        assert child.stdout is not None
        pending = b""
        with selectors.DefaultSelector() as selector, child.stdout as output:
            selector.register(output, selectors.EVENT_READ)
            while True:
                ready = selector.select(_POLL_S)
                self.peak_mb = max(self.peak_mb, memory.resident_mb() + memory.peak_mb(child.pid))
                if ready:
                    block = os.read(output.fileno(), 65536)
                    write(block)
                    # At its end the output need not have a line feed.
                    *lines, pending = (pending + (block or b"\n")).replace(b"\r", b"\n").split(b"\n")
                    for line in lines:
                        text = line.decode(errors="replace").rstrip()
                        if not _STACK_TRACE.match(text):
                            tail.append(text)
                        if on_line is not None:
                            on_line(as_colmap_3(text))
                    if not block:
                        return child.wait()
                if keep_going is not None and not keep_going():
                    raise SearchStoppedError


def _find(backend: str) -> tuple[str, list[str]]:
    """The backend that is available, "colmap" or "pycolmap", and the words of the command that starts it."""
    name = os.environ.get("MALUS_COLMAP") or DEFAULT_PROGRAM
    program = shutil.which(name)
    package = importlib.util.find_spec(PACKAGE) is not None
    # If MALUS_COLMAP names a program, the package must not replace it.
    named = name != DEFAULT_PROGRAM
    if backend != PACKAGE and program is not None:
        return "colmap", [os.path.abspath(program)]  # Absolute: started in other folders, too.
    if backend == PACKAGE or (backend == "auto" and not named):
        if package:
            return PACKAGE, [sys.executable, "-P", str(_DRIVER)]
        if backend == PACKAGE:
            raise ExternalError(
                f'photos.backend = "{PACKAGE}" needs the Python package {PACKAGE}, which is not installed: {_GET_PACKAGE}; '
                f'or use the program: {_GET_PROGRAM} and photos.backend = "colmap"'
            )
        raise ExternalError(
            f"[photos] needs COLMAP: the program `{name}` is not installed or not in PATH, and the Python package {PACKAGE} "
            f"is not installed; {_GET_PROGRAM}, or {_GET_PACKAGE}"
        )
    raise ExternalError(
        f"[photos] needs the program `{name}`, which is not installed or not in PATH: {_GET_PROGRAM}; "
        f'or use the Python package: {_GET_PACKAGE} and photos.backend = "{PACKAGE}"'
    )


def _end(child: subprocess.Popen[bytes]) -> None:
    """End the child's process group, gently first."""
    for ending in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(child.pid, ending)
        except ProcessLookupError:
            break
        try:
            child.wait(_GRACE_S)
            break
        except subprocess.TimeoutExpired:
            continue
    child.wait()
