"""The output of `malus paper`: plates as PNG, SVG, PDF and CSV, and the tables."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

from malus import _core
from malus._files import write_bytes, write_text
from malus.errors import InputError
from malus.figures import Figure, Plates, histograms, maps, profiles
from malus.paper import plates as own
from malus.paper.contact_sheet import contact_sheet
from malus.paper.tables import SURFACES, WORDS, Table, table_1, table_2
from malus.pictures import encode
from malus.workspace import Workspace

TABLES = ("table_1", "table_2")
_NAMES = (
    "*Photogrammetry* is what malus calls the prior everywhere else, and *fusion* its fused surface. "
    "The numbers of each figure are in the CSV file of its name.\n"
)


def _numbered(plates: Plates) -> Iterator[tuple[str, Figure]]:
    """Every figure, with the number of the corresponding figure in the paper."""
    quality = plates.quality
    groups: list[tuple[str, Iterator[Figure]]] = [
        ("01c", own.sinusoids(plates)),
        ("05", maps.polarization(plates)),
        ("06", maps.height(plates)),
        ("08", maps.elevations(plates)),
        ("09", own.cloud(plates)),
        ("10", maps.shadings(plates)),
        ("10", own.views(plates)),
        ("11", iter([profiles.profile_lines(plates)] if quality["profiles"] else [])),
        ("12", profiles.profiles(plates)),
        ("14", own.patch_boxes(plates)),
        ("15", histograms.patches(plates)),
    ]
    for number, figures in groups:
        for figure in figures:
            yield number, figure


def write_paper(work: str | Path) -> Path:
    """Write the plates and tables of a finished workspace to WORK/paper; returns that folder.

    Each plate is written as fig_NN_name.png, .svg, .pdf and .csv; NN is the number of the corresponding figure in the paper.
    captions.md has the captions, contact_sheet.png shows all plates on one page, and each table is written as .csv and .md. Raises
    InputError if a file that they show was changed after its step wrote it.
    """
    watch, workspace = _core.StepWatch(), Workspace(work)
    plates = Plates(workspace, for_print=True, words=SURFACES)
    tables = [table_1(workspace), table_2(workspace)]
    pictures, captions = [], []
    with workspace.recording("paper", watch) as files:
        for number, figure in _numbered(plates):
            pictures.append((f"{number} {figure.name}", figure.picture))
            name = f"paper/fig_{number}_{figure.name}"
            captions.append(
                f"**Fig. {number.lstrip('0')}**, `fig_{number}_{figure.name}`: {figure.title}. {figure.caption}\n"
            )
            for ending, content in (
                ("png", figure.png()),
                ("svg", figure.vector("svg")),
                ("pdf", figure.vector("pdf")),
                ("csv", figure.csv().encode()),
            ):
                write_bytes(workspace.folder / f"{name}.{ending}", content)
                files.append(f"{name}.{ending}")
        write_bytes(workspace.folder / "paper/contact_sheet.png", encode(contact_sheet(pictures), "PNG"))
        files.append("paper/contact_sheet.png")
        write_text(workspace.folder / "paper/captions.md", "\n".join([_NAMES, *captions]))
        files.append("paper/captions.md")
        for table in tables:
            files += [f"paper/{name}" for name in _write_table(workspace.folder / "paper", table)]
    return workspace.folder / "paper"


def _write_table(folder: Path, table: Table) -> list[str]:
    write_text(folder / f"{table.name}.csv", table.csv())
    write_text(folder / f"{table.name}.md", f"{table.title}\n\n{table.markdown()}")
    return [f"{table.name}.csv", f"{table.name}.md"]


def merge_campaign(works: Sequence[str | Path], output: str | Path) -> list[Path]:
    """Merge Table 1 and Table 2 of several workspaces, in the given order, to OUTPUT/table_N.csv and .md; returns the paths.

    Raises InputError for a workspace that `malus paper` has not finished, or for units that differ.
    """
    if not works:
        raise InputError("--campaign: no workspace, expected at least one folder that `malus paper` left")
    paths: list[Path] = []
    for name in TABLES:
        header: list[str] = []
        rows: list[list[str | float | None]] = []
        for work in works:
            workspace = Workspace(work)
            if not workspace.has(f"paper/{name}.csv"):
                raise InputError(
                    f"{work}: has no tables, expected a workspace that `malus paper STATION.toml` has finished"
                )
            path = workspace.path(f"paper/{name}.csv")
            with path.open(encoding="utf-8", newline="") as file:
                first, *others = csv.reader(file)
            if header and first != header:
                raise InputError(f"{path}: columns {', '.join(first)}, expected {', '.join(header)} as in {works[0]}")
            header = first
            rows += [[_cell(*cell) for cell in zip(header, row, strict=True)] for row in others]
        table = Table(name, f"Table {name[-1]} of {len(works)} objects", header, rows)
        paths += [Path(output) / written for written in _write_table(Path(output), table)]
    return paths


def _cell(column: str, text: str) -> str | float | None:
    if column in WORDS:
        return text or None
    return float(text) if text else None
