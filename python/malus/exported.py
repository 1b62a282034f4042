"""A record of what the files in WORK/export/ were made from; later runs warn of files made from an earlier result (overtaken_exports)."""

from __future__ import annotations

import fcntl
from pathlib import Path

from malus._files import read_record, write_record
from malus.workspace import Workspace

_RECORD = "made_from.json"


def note(workspace: Workspace, path: Path) -> None:
    """Record what a file or folder was made from, if it is in WORK/export/: all files that were read from the workspace."""
    folder = workspace.folder / "export"
    if path.parent.resolve() != folder.resolve():
        return
    record = folder / _RECORD
    made_from = {name: workspace.outputs[name]["sha256"] for name in workspace.read}
    # Exports that end at the same time would lose each other's entries.
    with (folder / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        write_record(record, {**(read_record(record) or {}), path.name: made_from})
