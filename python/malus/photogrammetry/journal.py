"""Which stages of the photogrammetry are done, so that a run that was stopped goes on where it was."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from malus import _core
from malus.photogrammetry import database


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Journal:
    """Marks of finished stages, `done/<stage>.json` below a folder.

    A stage's key is the hash of malus's version, of what it was given and of the key of the stage before it; it is done when its mark has
    that key and its outputs are there with the size they had.
    """

    def __init__(self, folder: Path) -> None:
        """Keep the marks below `folder`, which is created if needed."""
        self.folder = folder
        self._marks = folder / "done"
        self._marks.mkdir(parents=True, exist_ok=True)
        self._previous = ""

    def stage(
        self,
        name: str,
        inputs: Mapping[str, Any],
        outputs: Sequence[str],
        run: Callable[[], dict[str, Any]],
    ) -> dict[str, Any]:
        """Notes of a stage: those of its mark if it is done, else those that `run` returns, after it has been run.

        `outputs` are files or folders below the journal's folder. They are removed before the stage is run. The notes
        must be JSON and get the seconds it took.
        """
        text = json.dumps(
            {"stage": name, "version": _core.version, "inputs": inputs, "after": self._previous}, sort_keys=True
        )
        self._previous = key = hashlib.sha256(text.encode()).hexdigest()
        mark = self._marks / f"{name}.json"
        done = self._read(mark)
        if done.get("key") == key and done.get("sizes") == self._sizes(outputs):
            notes: dict[str, Any] = done["notes"]
            return notes
        mark.unlink(missing_ok=True)
        for output in outputs:
            self._remove(self.folder / output)
        start = time.monotonic()
        notes = run()
        notes["seconds"] = round(time.monotonic() - start, 2)
        self._write(mark, {"key": key, "sizes": self._sizes(outputs), "notes": notes})
        return notes

    def _sizes(self, outputs: Sequence[str]) -> dict[str, int]:
        sizes: dict[str, int] = {}
        for output in outputs:
            path = self.folder / output
            files = sorted(path.rglob("*")) if path.is_dir() else [path]
            for file in files:
                if file.is_file():
                    sizes[str(file.relative_to(self.folder))] = file.stat().st_size
        return sizes

    @staticmethod
    def _read(mark: Path) -> dict[str, Any]:
        try:
            content = json.loads(mark.read_text())
        except (OSError, ValueError):
            return {}
        return content if isinstance(content, dict) else {}

    @staticmethod
    def _write(mark: Path, content: Mapping[str, Any]) -> None:
        part = mark.with_suffix(".part")
        with part.open("w") as file:
            json.dump(content, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        part.replace(mark)

    @staticmethod
    def _remove(path: Path) -> None:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            database.remove(path)
