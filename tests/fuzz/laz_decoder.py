"""Decodes LAZ files as `malus._laz` does, but not with a new Python for each: that takes a thousand times as long as a file.

    python laz_decoder.py

reads requests from standard input and writes answers to standard output, each a line of JSON that states how many bytes of
points follow. A process decodes one file after the other until one ends it; then the next one is forked.
"""

from __future__ import annotations

import importlib
import io
import json
import os
import resource
import subprocess
import sys
from typing import Any

from malus import _laz


class Decoder:
    """Stands for `subprocess.run` in `malus._laz`."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "RUST_BACKTRACE": "0"},  # a backtrace takes longer than a hundred files
        )

    def __call__(self, command: list[str], **_: Any) -> subprocess.CompletedProcess[bytes]:
        """Decode the file of a command of `malus._laz.decoded`."""
        path, *fields = command[command.index(_laz.__file__) + 1 :]
        requests, answers = self._process.stdin, self._process.stdout
        assert requests is not None and answers is not None
        requests.write(json.dumps([path, fields]).encode() + b"\n")
        requests.flush()
        said = json.loads(answers.readline())
        points = answers.read(said["bytes"])
        return subprocess.CompletedProcess(command, said["code"], points, said["message"].encode())


def _answer(code: int, message: str, points: bytes) -> None:
    said = {"code": code, "message": message, "bytes": len(points)}
    sys.stdout.buffer.write(json.dumps(said).encode() + b"\n" + points)
    sys.stdout.buffer.flush()


def _answer_all() -> None:
    """Answer requests until standard input ends, or a file ends this process."""
    most = resource.getrlimit(resource.RLIMIT_DATA)[1]
    for request in sys.stdin:
        path, fields = json.loads(request)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))  # not the limit of the file before
        points = io.BytesIO()
        end = _laz.answer(path, fields, points)
        code, message = (end, "") if isinstance(end, int) else (1, end)
        _answer(code, message, points.getvalue())


def main() -> None:
    """Have requests answered by processes that have imported the decoder already."""
    for library in ("laspy", "lazrs"):
        importlib.import_module(library)
    while True:
        child = os.fork()
        if child == 0:
            _answer_all()
            os._exit(0)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code == 0:
            return
        _answer(code, "", b"")


if __name__ == "__main__":
    main()
