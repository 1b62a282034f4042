"""A station file from a folder of images, whether or not they were taken for another program."""

from __future__ import annotations

import csv
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from malus import _core
from malus._files import natural, read_regular, reading, relative_path, require_utf8, resolved, write_text
from malus.capture import BAYER_PATTERNS
from malus.errors import InputError
from malus.photogrammetry.metashape import MetashapeChunk, metashape_chunks, read_metashape
from malus.photogrammetry.model import colmap_params
from malus.raw import is_image, is_raw
from malus.units import METERS

_FILE_COLUMNS = ("image", "file", "filename", "name")
_ANGLE_COLUMNS = ("angle_deg", "angle", "polarizer_angle", "polarizer")
_EXPOSURE_COLUMNS = ("exposure_s", "exposure", "exposure_time")
#: After this number cameras count from 1, or from 0.
_LAST_NUMBER = 9999


@dataclass(frozen=True)
class Shot:
    """One image, its polarizer angle [deg] and exposure time [s]."""

    image: Path
    angle_deg: float
    exposure_s: float | None = None


def import_station(
    folder: str | Path,
    output: str | Path,
    *,
    table: str | Path | None = None,
    pattern: str | None = None,
    angles: Sequence[float] | None = None,
    mosaic: Sequence[float] | None = None,
    colors: str | None = None,
    metashape: str | Path | None = None,
    label: str | None = None,
    cloud: str | Path | None = None,
    unit: str | None = None,
) -> Path:
    """Write a station file for the images of a folder, and return its path.

    The angles [deg] come from the first of these sources that exists:

    - `angles`, one for each image in natural order of their names.
    - `pattern`, a regular expression whose one group captures the angle in a file's name.
    - `table`, a CSV file, or else the folder's only CSV file: a column for the file and one for the angle (image, angle_deg,
      exposure_s; other usual names too), separated by commas, semicolons or tabs, decimal commas allowed with the latter two.
      It must list every image of the folder once.
    - JSON files beside the images as polanalyser writes them (its `mueller_psa`, or a number under `polarizer_angle`, `angle_deg`
      or `angle`, degrees).
    - The file names: numbers beside a word such as pol or deg, if they are clearly the series of a polarizer and not the numbers
      of the files.

    Only one of `angles`, `pattern` and `table` may be given.

    `mosaic` and `colors` describe a polarization camera whose only image is in the folder. A file mask.png becomes the mask.
    `metashape` is the cameras.xml of an Agisoft Metashape project in which the polarized view was aligned, too; `label` is the
    label of that view's camera, in whichever chunk, whose lens and pose become [camera]. `cloud` is the project's cloud in the same
    frame and becomes [prior]; `unit` is the unit of both, by default meters if cameras.xml says so, else millimeters. Without them,
    [camera] and [prior] must be written into the file by hand. The station has the name of its file, or, if that is station.toml, of
    its folder. Raises malus.InputError; an existing file is not replaced.
    """
    folder, output = Path(folder), Path(output)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder, expected one with polarized images")
    if colors is not None and (mosaic is None or colors not in BAYER_PATTERNS):
        raise InputError(f"--colors {colors}, expected one of {', '.join(BAYER_PATTERNS)}, with --mosaic")
    if (metashape is None) != (label is None):
        raise InputError(
            "--metashape and --label go together: the project's cameras, and which one of them is the station's"
        )
    if unit is not None and unit not in METERS:
        raise InputError(f"--unit {unit}, expected one of {', '.join(METERS)}")
    if cloud is not None and not Path(cloud).is_file():
        raise InputError(f"--cloud {cloud}: no such file")
    if output.suffix != ".toml":
        raise InputError(f"{output}, expected a name for the station file that ends in .toml")
    if output.exists():
        raise InputError(f"{output} exists already, expected a name for a new station file")
    mask = mask_of(folder)
    if mosaic is not None:
        lines = _mosaic_lines(images_of(folder, mask), output, mosaic, colors)
    else:
        lines = _shot_lines(shots_of(folder, mask, table, pattern, angles), output)
    if mask is not None:
        lines.append(f"mask = {_text(relative_path(mask, output))}")
    camera: list[str] = []
    if metashape is not None and label is not None:
        chunk, camera = _camera_lines(Path(metashape), label)
        if unit is None and chunk.in_meters:
            unit = "m"
    prior = [] if cloud is None else ["[prior]", f"cloud = {_text(relative_path(Path(cloud), output))}", ""]
    missing = [part for part, lines_of in (("[camera]", camera), ("[prior]", prior)) if not lines_of]
    note = [f"# To come: {' and '.join(missing)}."] if missing else []
    if len(missing) == 2:
        note = [
            "# To come: [camera] and [prior], or [photos] with [[scale]] or [[control]]; without them `malus decompose` makes "
            "the polarization maps, and `malus height` a height from them."
        ]
    # The folder of the images is mostly called pol, in every station.
    file = resolved(output)
    name = file.parent.name if file.name == "station.toml" else file.stem
    head = ["[station]", f"name = {_text(name)}", f"unit = {_text(unit or 'mm')}", ""]
    write_text(output, "\n".join([*head, "[polarized]", *lines, "", *camera, *prior, *note, ""]))
    return output


def _camera_lines(cameras_xml: Path, label: str) -> tuple[MetashapeChunk, list[str]]:
    """The chunk of the camera with this label, and the lines of [camera]."""
    chunks = metashape_chunks(cameras_xml)
    named = [(number, name) for number, chunk in enumerate(chunks) for name in chunk.cameras]
    found = [(number, name) for number, name in named if label in (name, Path(name).stem)]
    if len(found) != 1:
        in_chunk = [f" of {chunk.label}" if len(chunks) > 1 else "" for chunk in chunks]
        shown = sorted(f"{name}{in_chunk[number]}" for number, name in found or named)
        some = ", ".join(shown[:10]) + (" …" if len(shown) > 10 else "")
        one = "one in all chunks (export the cameras of a single chunk)" if len(chunks) > 1 else "one"
        raise InputError(
            f"{cameras_xml}: {len(found)} aligned cameras {label!r}, expected {one}; there are {some or 'none'}"
        )
    ((number, name),) = found
    camera = read_metashape(cameras_xml, number, name)[name]
    rotation, translation = camera.pose()
    note = "# geocentric: prior and control points must be, too; or export all of the project in local coordinates"
    return chunks[number], [
        *([note] if chunks[number].on_earth else []),
        f"[camera]  # {name} of {cameras_xml.name}",
        f"model = {_text(camera.model)}",
        f"width = {camera.width}",
        f"height = {camera.height}",
        f"params = {_numbers(colmap_params(camera), 17)}",
        f"qvec = {_numbers(_core.quaternion_of(rotation), 17)}",
        f"tvec = {_numbers(translation, 17)}",
        "",
    ]


def _numbers(values: Iterable[float], digits: int = 10) -> str:
    return "[" + ", ".join(f"{value:.{digits}g}" for value in values) + "]"


def _visible(folder: Path) -> list[Path]:
    """What lies in the folder, without hidden files: macOS adds one, such as ._angles.csv, to every file on a disk of another system."""
    return [path for path in folder.iterdir() if not path.name.startswith(".")]


def mask_of(folder: Path) -> Path | None:
    """The folder's mask.png, which becomes the station's mask; None if there is none."""
    return next((path for path in folder.iterdir() if path.name.lower() == "mask.png"), None)


def images_of(folder: Path, mask: Path | None) -> list[Path]:
    """The folder's RAW files, or, without RAW files, its other images except the mask, in natural order; InputError for none."""
    files = [path for path in _visible(folder) if path.is_file() and path != mask]
    raw = [path for path in files if is_raw(path)]
    images = raw or [path for path in files if is_image(path)]
    if not images:
        kinds = sorted({path.suffix for path in files if path.suffix})
        raise InputError(f"{folder}: no images, expected PNG, TIFF, JPEG or RAW files" + (f" (there are {', '.join(kinds)})" if kinds else ""))  # fmt: skip
    for path in images:
        require_utf8(path)
    images.sort(key=lambda path: natural(path.name))
    named: dict[str, Path] = {}
    for path in images:  # such as a TIFF and its JPEG preview
        if (other := named.setdefault(path.stem, path)) != path:
            raise InputError(
                f"{folder}: {other.name} and {path.name} have the same name, expected one file of each image"
            )
    return images


def shots_of(
    folder: Path,
    mask: Path | None,
    table: str | Path | None,
    pattern: str | None,
    angles: Sequence[float] | None,
    instead: str = "--angles A,B,…, one for each in this order, --pattern REGEX or a table (--table FILE.csv)",
) -> list[Shot]:
    """Images and angles of a folder, from the first source that exists (see `import_station`); `instead`: what the error message
    asks for if no source exists.
    """
    given = [
        name for name, value in (("--angles", angles), ("--pattern", pattern), ("--table", table)) if value is not None
    ]
    if len(given) > 1:
        raise InputError(f"{' and '.join(given)} are both given, expected one source of angles")
    images = images_of(folder, mask)
    if angles is not None:
        if len(angles) != len(images):
            names = ", ".join(path.name for path in images)
            raise InputError(
                f"--angles has {len(angles)} angles for {len(images)} images ({names}), expected one for each"
            )
        _require_one_count(images)
        return [Shot(path, angle) for path, angle in zip(images, angles, strict=True)]
    if pattern is not None:
        return [Shot(path, _core.angle_of_name(path, pattern, "--pattern")) for path in images]
    tables = sorted(path for path in _visible(folder) if path.suffix.lower() == ".csv")
    if table is None and len(tables) == 1:
        table = tables[0]
    if table is not None:
        return _all_once(_shots_of_table(folder, Path(table)), images, str(table))
    shots = _shots_of_sidecars(folder, images)
    if shots:
        return _all_once(shots, images, f"the JSON files of {folder}")
    found = _core.angles_of_names(images, str(folder), f"expected {instead}")
    return [Shot(path, angle) for path, angle in zip(images, found, strict=True)]


def _require_one_count(images: list[Path]) -> None:
    """InputError if the camera's numbers began anew within the series: 0001 follows _LAST_NUMBER, but sorts before it."""
    numbers = [int(found[1]) if (found := re.search(r"(\d{4,})\D*$", path.stem)) else None for path in images]
    if _LAST_NUMBER in numbers and (0 in numbers or 1 in numbers):
        last = images[numbers.index(_LAST_NUMBER)]
        raise InputError(
            f"--angles goes by the order of the names, in which {images[0].name} comes first; but the camera numbered it after "
            f"{last.name}, expected names in the order of the angles, or a table (--table FILE.csv)"
        )


def _all_once(shots: list[Shot], images: list[Path], source: str) -> list[Shot]:
    """The shots that a table or files list; InputError unless they list every image of the folder exactly once."""
    listed = [resolved(shot.image) for shot in shots]
    twice = sorted({path.name for path in listed if listed.count(path) > 1})
    if twice:
        raise InputError(f"{source}: {', '.join(twice)} stands there more than once, expected every image once")
    missing = [path.name for path in images if resolved(path) not in listed]
    if missing:
        raise InputError(
            f"{source}: {', '.join(missing)} of {images[0].parent} {'is' if len(missing) == 1 else 'are'} not listed, "
            "expected every image of the folder (move other images elsewhere)"
        )
    return shots


def _number(value: object, where: str) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{where} is {value!r}, expected a number")
    return number


def _rows_of(table: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Column names, and (last line, values by column) of every row of a CSV file; InputError for a row with another number of columns.

    Spreadsheet programs do not always write UTF-8. Their column separator depends on the country, and numbers may have decimal
    commas if the separator is another sign.
    """
    with reading(table):
        content = read_regular(table)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = content.decode("utf-16", errors="replace")
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
    lines = re.split(r"\r\n?|\n", text.rstrip("\r\n"))  # splitlines also splits at signs that may stand in names
    first = next((index for index, line in enumerate(lines) if line.strip()), None)
    if first is None:
        raise InputError(f"{table}: empty, expected column names in the first line")
    stated = re.fullmatch(r"sep=(.)", lines[first].strip())
    if stated:  # a line with which spreadsheet programs state the separator
        first += 1
    header = lines[first] if first < len(lines) else ""
    delimiter = stated[1] if stated else max(";\t,", key=header.count)
    reader = csv.reader(lines[first:], delimiter=delimiter, skipinitialspace=True, strict=True)
    try:
        rows = [(first + reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise InputError(f"{table}: cannot be read as a table ({error})") from None
    if not rows:
        raise InputError(f"{table}: empty, expected column names in the first line")
    names = [name.strip() for name in rows[0][1]]
    known = Counter(name.lower() for name in names if name)
    if twice := [name for name in names if known[name.lower()] > 1]:
        raise InputError(f"{table}: {known[twice[0].lower()]} columns are named {twice[0]!r}, expected each name once")
    result = []
    for line, row in rows[1:]:
        cells = [cell.strip() for cell in row]
        if not any(cells):
            continue
        while len(cells) > len(names) and not cells[-1]:
            cells.pop()
        if len(cells) != len(names):
            raise InputError(
                f"{table}, line {line}: {len(cells)} columns separated by {delimiter!r}, expected {len(names)} as in the "
                "first line (numbers with decimal commas need columns separated by semicolons)"
            )
        if delimiter != ",":
            cells = [re.sub(r"^([+-]?\d+),(\d+)$", r"\1.\2", cell) for cell in cells]
        result.append((line, dict(zip(names, cells, strict=True))))
    return names, result


def _shots_of_table(folder: Path, table: Path) -> list[Shot]:
    columns, rows = _rows_of(table)
    names = {name.lower(): name for name in columns}

    def column(choices: tuple[str, ...]) -> str | None:
        return next((names[choice] for choice in choices if choice in names), None)

    file_column, angle_column, exposure_column = (
        column(choices) for choices in (_FILE_COLUMNS, _ANGLE_COLUMNS, _EXPOSURE_COLUMNS)
    )
    if file_column is None or angle_column is None:
        choices = _FILE_COLUMNS if file_column is None else _ANGLE_COLUMNS
        raise InputError(f"{table}: no column {choices[0]!r}, expected one of {', '.join(choices)} in the first line")
    shots = []
    for line, row in rows:
        name = row[file_column]
        image = folder / name
        if not name or not image.is_file():
            raise InputError(f"{table}, line {line}: no file {name!r} in {folder}")
        angle = _number(row[angle_column], f"{table}, line {line}: {angle_column}")
        exposure = None
        if exposure_column is not None:
            exposure = _number(row[exposure_column], f"{table}, line {line}: {exposure_column}")
        shots.append(Shot(image, angle, exposure))
    if not shots:
        raise InputError(f"{table}: no rows below the first line")
    return shots


def _shots_of_sidecars(folder: Path, images: Sequence[Path]) -> list[Shot]:
    """The images that JSON files in the folder describe; empty without such files."""
    shots = []
    sidecars = (path for path in _visible(folder) if path.suffix == ".json")
    for path in sorted(sidecars, key=lambda path: natural(path.name)):
        try:
            content = json.loads(read_regular(path))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"{path}: cannot be read as JSON ({error})") from None
        if not isinstance(content, dict):
            continue
        angle = _angle_of_sidecar(content, path)
        if angle is None:
            continue
        shots.append(Shot(_image_of_sidecar(content, path, images), angle))
    return shots


def _image_of_sidecar(content: dict[str, Any], path: Path, images: Sequence[Path]) -> Path:
    """The image that a JSON file describes: the file that it names, else the image of the folder with its own name."""
    if "filename" in content:
        image = path.parent / str(content["filename"])
        if not image.is_file():
            raise InputError(f"{path}: filename = {content['filename']!r}, no such file beside it")
    else:
        image = next((image for image in images if image.stem == path.stem), path)
    if not is_image(image):
        raise InputError(f"{path}: its image is {image.name}, expected PNG, TIFF, JPEG or RAW")
    return image


def _angle_of_sidecar(content: dict[str, Any], path: Path) -> float | None:
    for key in ("polarizer_angle", "angle_deg", "angle"):
        if key in content:
            return _number(content[key], f"{path}: {key}")
    mueller = content.get("mueller_psa")
    if mueller is None:
        return None
    values: Any = mueller.get("values") if isinstance(mueller, dict) else mueller
    try:
        first = [float(value) for value in values[0][:3]]
    except (TypeError, ValueError, IndexError, KeyError):
        raise InputError(f"{path}: mueller_psa, expected a 3 × 3 or 4 × 4 matrix") from None
    # First row of a linear polarizer's Mueller matrix: (1, cos 2a, sin 2a) / 2.
    if len(first) < 3 or abs(math.hypot(first[1], first[2]) - first[0]) > 0.01 * abs(first[0]) or not first[0] > 0:
        raise InputError(f"{path}: mueller_psa is not that of a linear polarizer")
    return math.degrees(math.atan2(first[2], first[1]) / 2) % 180


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)


def _shot_lines(shots: list[Shot], output: Path) -> list[str]:
    images = ", ".join(_text(relative_path(shot.image, output)) for shot in shots)
    lines = [f"images = [{images}]", f"angles_deg = {_numbers(shot.angle_deg for shot in shots)}"]
    exposures = [shot.exposure_s for shot in shots if shot.exposure_s is not None]
    if len(set(exposures)) > 1:
        lines.append(f"exposure_s = {_numbers(exposures)}")
    return lines


def _mosaic_lines(images: list[Path], output: Path, mosaic: Sequence[float], colors: str | None) -> list[str]:
    if len(mosaic) != 4:
        raise InputError(f"--mosaic has {len(mosaic)} angles, expected the four of a 2 × 2 cell by rows: 90,45,135,0")
    if len(images) != 1:
        raise InputError(f"--mosaic is for one image, but there are {len(images)} in {images[0].parent}")
    rows = f"[{_numbers(mosaic[:2])}, {_numbers(mosaic[2:])}]"
    lines = [f"images = [{_text(relative_path(images[0], output))}]", f"mosaic = {rows}"]
    return lines if colors is None else [*lines, f"mosaic_colors = {_text(colors)}"]
