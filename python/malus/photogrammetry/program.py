"""COLMAP as a child process: started, watched, logged and ended here."""

from __future__ import annotations

import os
import re
import selectors
import shutil
import signal
import subprocess
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path

from malus.errors import ExternalError

#: Name of the program, or the path that the environment variable MALUS_COLMAP gives.
DEFAULT_PROGRAM = "colmap"
_POLL_S = 0.2
_GRACE_S = 3.0
_TAIL_LINES = 5


class SearchStoppedError(Exception):
    """The child was ended because `keep_going` said so."""


class Colmap:
    """The `colmap` program of this machine."""

    def __init__(self, threads: int) -> None:
        """Find the program. Raises ExternalError when it is missing or does not start."""
        name = os.environ.get("MALUS_COLMAP", DEFAULT_PROGRAM)
        found = shutil.which(name)
        if found is None:
            raise ExternalError(
                f"[photos] needs the program `{name}`, which is not installed or not in PATH; "
                "on Debian and Ubuntu: apt install colmap"
            )
        self.path = found
        self.threads = threads
        self.version = self._read_version()

    def _read_version(self) -> str:
        try:
            help_text = subprocess.run(
                [self.path, "help"], capture_output=True, text=True, timeout=60, env=self._environment()
            ).stdout
        except (OSError, subprocess.TimeoutExpired) as error:
            raise ExternalError(f"{self.path} does not start: {error}") from None
        match = re.search(r"COLMAP (\d+\.\d+[\w.]*)", help_text)
        if match is None:
            raise ExternalError(
                f"{self.path} does not say which COLMAP it is, expected `colmap help` to name its version"
            )
        return match.group(1)

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
    ) -> None:
        """Run `colmap COMMAND --key value …`, its output going to the file `log` and line by line to `on_line`.

        Raises ExternalError with the last lines of its output when it fails, and SearchStoppedError when `keep_going` returned
        False. Ctrl-C, or any error here, ends the child with everything it started.
        """
        words = [self.path, command]
        for key, value in arguments.items():
            words += [f"--{key}", str(int(value) if isinstance(value, bool) else value)]
        setpriv = shutil.which("setpriv")
        if setpriv is not None:  # So that it ends with us even when we are killed.
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
            )
            try:
                code = self._watch(child, log_file.write, tail, on_line, keep_going)
            except BaseException:
                _end(child)
                raise
        if code != 0:
            how = f"was ended by signal {-code}" if code < 0 else f"failed with exit code {code}"
            last = " / ".join(line for line in tail if line.strip())
            raise ExternalError(f"colmap {command} {how}: {last or 'it said nothing'} (all of it is in {log})")

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
                if selector.select(_POLL_S):
                    block = os.read(output.fileno(), 65536)
                    if not block:
                        return child.wait()
                    write(block)
                    *lines, pending = (pending + block).replace(b"\r", b"\n").split(b"\n")
                    for line in lines:
                        text = line.decode(errors="replace").rstrip()
                        if text:
                            tail.append(text)
                        if on_line is not None:
                            on_line(text)
                if keep_going is not None and not keep_going():
                    raise SearchStoppedError


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
