"""Station files from folders of images."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import malus
from conftest import malus_here


def image(path: Path, size: tuple[int, int] = (8, 12)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full(size, 90, np.uint8)).save(path)


def polarized(station: Path) -> dict[str, Any]:
    """[polarized] of the file, which malus must be able to read."""
    malus.Station.load(station)
    content: dict[str, Any] = tomllib.loads(station.read_text())["polarized"]
    return content


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "shots"


def test_angles_in_names_in_natural_order(folder: Path, tmp_path: Path) -> None:
    for name in ("vase_pol0.png", "vase_pol60.png", "vase_pol120.png", "mask.png"):
        image(folder / name)
    outcome = malus_here("import", folder, "-o", tmp_path / "station.toml")
    assert outcome.code == 0, outcome.err
    content = polarized(tmp_path / "station.toml")
    assert content["images"] == ["shots/vase_pol0.png", "shots/vase_pol60.png", "shots/vase_pol120.png"]
    assert content["angles_deg"] == [0, 60, 120]
    assert content["mask"] == "shots/mask.png"


@pytest.mark.parametrize(("file", "name"), [("vase/station.toml", "vase"), ("vase/lid.toml", "lid")])
def test_station_is_not_named_after_the_folder_of_its_images(tmp_path: Path, file: str, name: str) -> None:
    for angle in (0, 45, 90):
        image(tmp_path / f"vase/pol/pol_{angle}.png")
    malus.import_station(tmp_path / "vase/pol", tmp_path / file)
    assert malus.Station.load(tmp_path / file).name == name


def test_pattern(folder: Path) -> None:
    for name in ("a030_take1.png", "a060_take1.png", "a090_take1.png"):
        image(folder / name)
    malus.import_station(folder, folder / "station.toml", pattern=r"a(\d+)_")
    assert polarized(folder / "station.toml")["angles_deg"] == [30, 60, 90]


def test_table_with_exposures(folder: Path) -> None:
    rows = ["\ufeffFile; Angle; exposure_s"]
    for angle in (0, 45, 90):
        for exposure in (0.01, 0.04):
            image(folder / f"i{angle}_{exposure}.png")
            rows.append(f"i{angle}_{exposure}.png; {angle}; {exposure}")
    (folder / "angles.csv").write_text("\n".join(rows), encoding="utf-8")
    malus.import_station(folder, folder / "station.toml")
    content = polarized(folder / "station.toml")
    assert content["angles_deg"] == [0, 0, 45, 45, 90, 90]
    assert content["exposure_s"] == [0.01, 0.04] * 3


def test_angles_may_begin_with_a_negative_one(folder: Path) -> None:
    """argparse takes -45,0,45 for an option: "--angles: expected one argument"."""
    for number in (1, 2, 3):
        image(folder / f"IMG_{number:04d}.png")
    outcome = malus_here("import", folder, "-o", folder / "station.toml", "--angles", "-45,0,45.5")
    assert outcome.code == 0, outcome.err
    assert polarized(folder / "station.toml")["angles_deg"] == [-45, 0, 45.5]


def test_signs_of_angles_in_names_are_read(folder: Path) -> None:
    for name in ("pol_-45.png", "pol_0.png", "pol_45.png", "pol_90.png"):
        image(folder / name)
    malus.import_station(folder, folder / "station.toml")
    assert polarized(folder / "station.toml")["angles_deg"] == [0, 45, 90, -45], "in the order of the names"


def test_file_numbers_are_not_taken_for_angles(folder: Path) -> None:
    for number in (123, 124, 125, 9, 10):
        image(folder / f"IMG_{number:04d}.png")
    outcome = malus_here("import", folder, "-o", folder / "station.toml")
    assert outcome.code == 2
    assert "IMG_0009.png, IMG_0010.png, IMG_0123.png" in outcome.err
    assert "--angles" in outcome.err
    assert not (folder / "station.toml").exists()
    outcome = malus_here("import", folder, "-o", folder / "station.toml", "--angles", "0,36,72,108,144")
    assert outcome.code == 0, outcome.err
    content = polarized(folder / "station.toml")
    assert dict(zip(content["images"], content["angles_deg"], strict=True)) == {
        "IMG_0009.png": 0, "IMG_0010.png": 36, "IMG_0123.png": 72, "IMG_0124.png": 108, "IMG_0125.png": 144,
    }  # fmt: skip


SEMICOLONS = "Bild;Datei;Angle;Größe\n1;a.png;0;5\n2;b.png;22,5;5\n\n3;c.png;67,5;6\n".replace("Datei", "File")


@pytest.mark.parametrize(
    "table",
    [
        SEMICOLONS.encode("latin-1"),
        SEMICOLONS.encode("utf-8-sig"),
        SEMICOLONS.encode("utf-16"),
        SEMICOLONS.replace("\n", "\r\n").encode(),
        SEMICOLONS.replace(";", "\t").encode(),
        b"sep=;\n" + SEMICOLONS.encode(),
        b'file,angle,note\na.png,0,x\nb.png,22.5,\n c.png , 67.5,"y, z",\n',
    ],
)
def test_tables_of_spreadsheet_programs(folder: Path, table: bytes) -> None:
    for name in "abc":
        image(folder / f"{name}.png")
    (folder / "angles.csv").write_bytes(table)
    malus.import_station(folder, folder / "station.toml")
    assert polarized(folder / "station.toml")["angles_deg"] == [0, 22.5, 67.5]


def test_polanalyser_sidecars(folder: Path) -> None:
    angles = (10, 70, 130)
    for index, angle in enumerate(angles):
        image(folder / f"image{index}.png")
        cosine, sine = np.cos(2 * np.radians(angle)), np.sin(2 * np.radians(angle))
        row = np.array([1, cosine, sine])
        # As polanalyser 3 writes arrays (PolarizationContainer.save).
        mueller = {"type": "ndarray", "values": (np.outer(row, row) / 2).tolist(), "dtype": "<f8"}
        sidecar = {"filename": f"image{index}.png", "mueller_psa": mueller}
        (folder / f"image{index}.json").write_text(json.dumps(sidecar))
    malus.import_station(folder, folder / "station.toml")
    assert polarized(folder / "station.toml")["angles_deg"] == pytest.approx(angles)


@pytest.mark.parametrize("suffix", [".png", ".PNG"])
def test_sidecars_with_a_plain_angle(folder: Path, suffix: str) -> None:
    for angle in (0, 60, 120):
        image(folder / f"shot_{angle // 60}{suffix}")
        (folder / f"shot_{angle // 60}.json").write_text(json.dumps({"polarizer_angle": angle}))
    malus.import_station(folder, folder / "station.toml")
    assert polarized(folder / "station.toml")["angles_deg"] == [0, 60, 120]


def test_json_files_must_describe_every_image_once(folder: Path) -> None:
    """Images without one were left out of the station without a word."""
    for number in range(4):
        image(folder / f"{number}.png")
        if number:
            (folder / f"{number}.json").write_text(json.dumps({"angle": 45 * number}))
    with pytest.raises(
        malus.InputError, match=r"the JSON files of .*: 0\.png of .* is not listed, expected every image"
    ):
        malus.import_station(folder, folder / "station.toml")
    (folder / "first.json").write_text(json.dumps({"angle": 0, "filename": "0.png"}))
    (folder / "again.json").write_text(json.dumps({"angle": 0, "filename": "0.png"}))
    with pytest.raises(malus.InputError, match=r"the JSON files of .*: 0\.png stands there more than once"):
        malus.import_station(folder, folder / "station.toml")


def test_hidden_files_are_not_read(folder: Path) -> None:
    for name in ("1.png", "2.png", "3.png"):
        image(folder / name)
    (folder / "angles.csv").write_text("file,angle\n1.png,0\n2.png,50\n3.png,100\n")
    (folder / "._angles.csv").write_bytes(b"\0\5\26\7")  # as macOS leaves it on a memory card
    malus.import_station(folder, folder / "station.toml")
    assert polarized(folder / "station.toml")["angles_deg"] == [0, 50, 100]
    for path in (folder / "angles.csv", folder / "._angles.csv", folder / "station.toml"):
        path.unlink()
    for number, angle in ((1, 20), (2, 60), (3, 100)):
        (folder / f"{number}.json").write_text(json.dumps({"angle": angle}))
        (folder / f"._{number}.json").write_bytes(b"\0\5\26\7")
    malus.import_station(folder, folder / "station.toml")
    assert polarized(folder / "station.toml")["angles_deg"] == [20, 60, 100]


def test_mosaic(folder: Path, tmp_path: Path) -> None:
    image(folder / "scene.png")
    outcome = malus_here("import", folder, "-o", tmp_path / "s.toml", "--mosaic", "90,45,135,0", "--colors", "RGGB")
    assert outcome.code == 0, outcome.err
    content = polarized(tmp_path / "s.toml")
    assert content["mosaic"] == [[90, 45], [135, 0]]
    assert content["mosaic_colors"] == "RGGB"


METASHAPE = """<document version="2.0.0"><chunk><sensors><sensor id="0" label="unknown" type="frame">
<resolution width="12" height="8"/><calibration type="frame" class="adjusted"><f>20</f><cx>0.5</cx><cy>-1</cy><k1>-0.1</k1>
<p1>1e-3</p1></calibration></sensor></sensors>
<components><component id="0"><transform><rotation>0 -1 0 1 0 0 0 0 1</rotation><translation>10 20 30</translation>
<scale>2</scale></transform></component></components>
<cameras><camera id="0" label="shot_0.png" sensor_id="0" component_id="0">
<transform>0 0 1 1  1 0 0 2  0 1 0 3  0 0 0 1</transform></camera>
<camera id="1" label="b" sensor_id="0" component_id="0"/></cameras></chunk></document>"""


def test_camera_and_cloud_of_a_metashape_project(folder: Path, tmp_path: Path) -> None:
    for angle in (0, 60, 120):
        image(folder / f"shot_{angle}.png")
    project = folder / "cameras.xml"
    project.write_text(METASHAPE)
    (folder / "cloud.ply").write_text("ply\n")
    station = folder / "station.toml"
    outcome = malus_here(
        "import", folder, "-o", station, "--metashape", project, "--label", "shot_0", "--cloud", folder / "cloud.ply",
        "--unit", "m", "--angles", "0,60,120",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    description = malus.Station.load(station).describe()
    camera = malus.photogrammetry.read_metashape(project)["shot_0.png"]
    assert description["camera"]["model"] == camera.model
    np.testing.assert_allclose(description["camera"]["params"], camera.params, atol=1e-12)
    rotation, translation = camera.pose()
    np.testing.assert_allclose(description["camera"]["rotation"], rotation, atol=1e-12)
    np.testing.assert_allclose(description["camera"]["translation"], translation, atol=1e-12)
    assert description["unit"] == "m"
    assert Path(description["prior_cloud"]) == folder / "cloud.ply"
    assert "To come" not in station.read_text()
    for label, expected in (("c", "0 aligned cameras 'c', expected one; there are shot_0.png"), (None, "go together")):
        name = [] if label is None else ["--label", label]
        outcome = malus_here(
            "import", folder, "-o", folder / "other.toml", "--angles", "0,60,120", "--metashape", project, *name
        )  # fmt: skip
        assert outcome.code == 2
        assert expected in outcome.err
        assert not (folder / "other.toml").exists()


def test_cameras_of_one_label_are_told_apart(folder: Path, tmp_path: Path) -> None:
    project = tmp_path / "cameras.xml"
    project.write_text(
        METASHAPE.replace(
            '<camera id="1" label="b"',
            '<camera id="7" label="shot_0.png" sensor_id="0" component_id="0"><transform>0 0 1 9  1 0 0 2  0 1 0 3  0 0 0 1'
            '</transform></camera><camera id="1" label="b"',
        )
    )
    assert list(malus.photogrammetry.read_metashape(project)) == ["shot_0.png (camera 0)", "shot_0.png (camera 7)"]
    image(folder / "shot_0.png")
    arguments = ("import", folder, "-o", tmp_path / "station.toml", "--angles", "0", "--metashape", project, "--label")
    outcome = malus_here(*arguments, "shot_0")
    assert (
        outcome.code == 2 and "2 aligned cameras 'shot_0', expected one; there are shot_0.png (camera 0)" in outcome.err
    )
    assert malus_here(*arguments, "shot_0.png (camera 7)").code == 0


def test_the_camera_is_found_in_whichever_chunk(folder: Path, tmp_path: Path) -> None:
    image(folder / "shot_0.png")
    chunk = METASHAPE[METASHAPE.index("<chunk>") : METASHAPE.index("</document>")]
    named = chunk.replace("<chunk>", '<chunk label="vase">')
    # Other chunks, and other cameras of this chunk, may have lenses that are not supported.
    fisheye = '<sensors><sensor id="9" type="fisheye"><resolution width="9" height="9"/><calibration><f>3</f></calibration></sensor>'
    named = named.replace("<sensors>", fisheye)
    other = chunk.replace("<chunk>", '<chunk label="copy">').replace("shot_0", "c")
    other = other.replace("<f>20</f>", "<f>21</f><b2>0.5</b2>")
    project = tmp_path / "cameras.xml"
    project.write_text(f"<document>{other}{named}</document>")
    arguments = ("import", folder, "--angles", "0", "--metashape", project, "--label", "shot_0", "-o")
    outcome = malus_here(*arguments, tmp_path / "station.toml")
    assert outcome.code == 0, outcome.err
    camera = tomllib.loads((tmp_path / "station.toml").read_text())["camera"]
    assert camera["params"][0] == 20
    project.write_text(f"<document>{other.replace('c.png', 'shot_0.png')}{named}</document>")
    outcome = malus_here(*arguments, tmp_path / "other.toml")
    assert outcome.code == 2
    assert "2 aligned cameras 'shot_0', expected one in all chunks" in outcome.err
    assert "shot_0.png of copy, shot_0.png of vase" in outcome.err


@pytest.mark.parametrize(
    ("coordinates", "unit", "geocentric"),
    [
        ('LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1]]', "m", False),
        ('LOCAL_CS["Local Coordinates",LOCAL_DATUM["Local Datum",0],UNIT["foot",0.3048]]', "mm", False),
        ('PROJCS["ETRS89 / UTM zone 32N",GEOGCS["ETRS89"]]', "m", True),
        ("", "mm", False),
    ],
)
def test_unit_and_frame_of_a_metashape_project(
    folder: Path, tmp_path: Path, coordinates: str, unit: str, geocentric: bool
) -> None:
    image(folder / "shot_0.png")
    project = tmp_path / "cameras.xml"
    project.write_text(METASHAPE.replace("</chunk>", f"<reference>{coordinates}</reference></chunk>"))
    for given in (None, "cm"):
        station = tmp_path / f"{given}.toml"
        malus.import_station(folder, station, angles=[0], metashape=project, label="shot_0", unit=given)
        assert tomllib.loads(station.read_text())["station"]["unit"] == (given or unit)
        assert ("# geocentric" in station.read_text()) == geocentric


@pytest.mark.parametrize(
    ("files", "arguments", "message"),
    [
        ({}, [], "no images, expected PNG, TIFF, JPEG or RAW"),
        ({"a.png": None}, [], "do not say the polarizer's angles beyond doubt: a.png"),
        ({"a.png": None}, ["--pattern", "b(\\d)"], "no angle in the name"),
        ({"a.png": None, "b.png": None}, ["--angles", "0"], "1 angles for 2 images (a.png, b.png)"),
        ({"a.png": None}, ["--angles", "0,x"], "--angles 0,x, expected angles in degrees"),
        (
            {"IMG_9999.png": None, "IMG_0001.png": None, "IMG_0002.png": None},
            ["--angles", "0,60,120"],
            "in which IMG_0001.png comes first; but the camera numbered it after IMG_9999.png",
        ),
        ({"a_0.png": None, "a_0.jpg": None}, ["--angles", "0,45"], "a_0.jpg and a_0.png have the same name"),
        ({"a.png": None}, ["--angles", "0", "--pattern", "(a)"], "--angles and --pattern are both given"),
        ({"a.png": None, "t.csv": "file;angle\na.png;1;2\n"}, [], "t.csv, line 2: 3 columns"),
        (
            {"a.png": None, "t.csv": "file,angle\na.png,22,5\n"},
            [],
            "decimal commas need columns separated by semicolons",
        ),
        ({"a.png": None, "b.png": None, "t.csv": "file;angle\na.png;1\n"}, [], "b.png of"),
        ({"a.png": None, "t.csv": "file;angle\na.png;1\na.png;2\n"}, [], "a.png stands there more than once"),
        ({"a.png": None, "t.csv": "\n\n"}, [], "t.csv: empty"),
        ({"a.png": None, "t.csv": "sep=;\n"}, [], "t.csv: empty"),
        ({"a_1.png": None}, ["--pattern", "a_\\d"], "one group"),
        ({"a_1.png": None}, ["--pattern", "a_(\\d"], "not a regular expression"),
        ({"a_1.png": None, "t.csv": "file,angle\nb.png,3\n"}, [], "t.csv, line 2: no file 'b.png'"),
        ({"a_1.png": None, "t.csv": "file,angle\na_1.png,x\n"}, [], "t.csv, line 2: angle is 'x', expected a number"),
        ({"a_1.png": None, "t.csv": 'file,angle,note\na_1.png,x,"two\nlines"\n'}, [], "t.csv, line 3: angle is 'x'"),
        (
            {"a_1.png": None, "t.csv": "file,angle,Angle\na_1.png,3,4\n"},
            [],
            "t.csv: 2 columns are named 'angle', expected each name once",
        ),
        ({"a_1.png": None, "t.csv": "file,degrees\na_1.png,3\n"}, [], "no column 'angle_deg'"),
        ({"a_1.png": None, "a_1.json": "{"}, [], "a_1.json: cannot be read as JSON"),
        ({"a_1.png": None, "a.json": '{"filename": "c.png", "angle": 3}'}, [], "no such file beside it"),
        ({"a_1.png": None, "a_1.json": '{"mueller_psa": [[1, 0, 0]]}'}, [], "not that of a linear polarizer"),
        ({"a_1.png": None, "a_2.png": None}, ["--mosaic", "90,45,135,0"], "for one image, but there are 2"),
        ({"a_1.png": None}, ["--mosaic", "90,45"], "has 2 angles"),
        ({"a_1.png": None}, ["--mosaic", "x"], "expected four angles"),
        ({"a_1.png": None}, ["--colors", "RGGB"], "with --mosaic"),
        ({"a_1.png": None, "station.toml": "x"}, [], "exists already"),
        ({"a_1.png": None}, ["--unit", "inch"], "--unit inch, expected one of um, mm"),
        ({"a_1.png": None}, ["--cloud", "no.ply"], "no.ply: no such file"),
    ],
)
def test_mistakes_are_named(folder: Path, files: dict[str, str | None], arguments: list[str], message: str) -> None:
    folder.mkdir()
    for name, content in files.items():
        if content is None:
            image(folder / name)
        else:
            (folder / name).write_text(content)
    outcome = malus_here("import", folder, "-o", folder / "station.toml", *arguments)
    assert outcome.code == 2, outcome.out
    assert message in outcome.err
    assert "Traceback" not in outcome.err
