"""Further files that some formats leave beside the file they are asked for."""

from __future__ import annotations

from pathlib import Path

#: Suffixes of further files that a format leaves beside the file it is asked for.
BESIDE = {"obj": (".png", ".mtl"), "orthophoto": (".pgw",), "rti": (".ptm.txt",)}


def files_beside(format: str, path: Path) -> list[Path]:
    """The further files that a format leaves beside `path`; in those of an OBJ, whose text names them, "_" replaces spaces, which end a name."""
    name = "_".join(path.name.split()) if format == "obj" else path.name
    return [path.with_name(name).with_suffix(suffix) for suffix in BESIDE.get(format, ())]
