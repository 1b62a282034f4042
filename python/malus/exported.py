"""Which of the files in WORK/export/ are of an earlier result: they are a user's, so they are told of and not removed."""

from __future__ import annotations

from pathlib import Path

from malus._files import read_record, write_record
from malus.workspace import Workspace

_RECORD = "made_from.json"


def note(workspace: Workspace, path: Path) -> None:
    """Record what a file or folder in WORK/export/ was made from: all that was read of the workspace."""
    record = workspace.folder / "export" / _RECORD
    made_from = {name: workspace.outputs[name]["sha256"] for name in workspace.read}
    write_record(record, {**(read_record(record) or {}), path.name: made_from})


def overtaken(folder: Path) -> list[Path]:
    """What lies in a workspace's export/ and was made from files that are not those of its steps any more."""
    exports = folder / "export"
    noted = read_record(exports / _RECORD)
    if noted is None:
        return []
    now = {name: output["sha256"] for name, output in Workspace(folder).outputs.items()}
    return [
        exports / name
        for name, made_from in noted.items()
        if (exports / name).exists() and any(now.get(file) != sha256 for file, sha256 in made_from.items())
    ]
