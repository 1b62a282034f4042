"""A record of what the files in WORK/export/ were made from; later runs warn of files made from an earlier result (overtaken_exports)."""

from __future__ import annotations

from pathlib import Path

from malus._files import read_record, write_record
from malus.workspace import Workspace

_RECORD = "made_from.json"


def note(workspace: Workspace, path: Path) -> None:
    """Record what a file or folder in WORK/export/ was made from: all files that were read from the workspace."""
    record = workspace.folder / "export" / _RECORD
    made_from = {name: workspace.outputs[name]["sha256"] for name in workspace.read}
    write_record(record, {**(read_record(record) or {}), path.name: made_from})
