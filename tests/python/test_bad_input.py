"""Every mistake a user can make ends with a message that says what and where, the right exit code, and nothing that looks finished."""

from __future__ import annotations

import os
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
import tifffile

from conftest import edit, half_written, malus, malus_here, malus_station
from malus import InputError, Station, _core
from malus.campaign import Campaign
from malus.object import Object

IMAGES = "images = ["
ANGLES = "angles_deg = [0, 30, 60, 90, 120, 150]"


def expect(
    station: Path, work: Path, code: int, *words: str, arguments: tuple[str, ...] = (), warnings: int = 0
) -> None:
    """Both programs must fail with this exit code, one message with these words, this many warnings, and no result left behind."""
    for program in (malus_here, malus_station):
        run_words = ("run",) if program is malus_here else ()
        outcome = program(*run_words, station, "-o", work, "--quiet", *arguments)
        assert outcome.code == code, f"{program.__name__}: {outcome}"
        for word in words:
            assert word in outcome.err, f"{program.__name__}: {word!r} is not in {outcome.err!r}"
        assert "Traceback" not in outcome.err
        lines = outcome.err.strip().splitlines()
        assert sum(line.startswith("warning: ") for line in lines) == warnings, outcome.err
        assert len(lines) == warnings + 1, outcome.err
        assert not (work / "fused" / "depth.tif").exists()
        assert not (work / "quality.json").exists()
        assert not half_written(work)


@pytest.fixture
def work(tmp_path: Path) -> Path:
    return tmp_path / "work"


def test_station_file_is_missing(tmp_path: Path, work: Path) -> None:
    expect(tmp_path / "none.toml", work, 2, "none.toml")


def test_station_file_is_not_toml(small_station: Path, work: Path) -> None:
    small_station.write_text("[station\nname=3")
    expect(small_station, work, 2, "station.toml")


def test_keys_of_thousands_of_parts_are_refused_before_the_parser_sees_them(small_station: Path, work: Path) -> None:
    small_station.write_text(f"[station]\n{'.'.join(['a'] * 50_000)} = 1\n")
    expect(small_station, work, 2, "station.toml, line 2", "parts")
    with pytest.raises(InputError, match="line 2: .*a key of more than 100 parts"):
        Campaign.load(small_station)


@pytest.mark.parametrize(
    "number",
    [
        "9" * 5000,
        "1_" * 50_000 + "1",
        "0x" + "f" * 5000,
        "99999999999999999999",
        "[9223372036854775808]",
        "1e999",
        "-1e999",
    ],
    ids=["5000 digits", "underscores", "hexadecimal", "20 digits", "64 bits", "exponent", "negative"],
)
def test_numbers_out_of_range_are_refused_in_every_file(small_station: Path, number: str) -> None:
    """tomllib raised another exception for some of them and read others that the C++ library refuses; printing those failed."""
    for table, load in (("campaign", Campaign.load), ("object", Object.load)):
        (small_station.parent / "x.toml").write_text(
            f'[{table}]\nstations = ["station.toml"]\n[options.refine]\niterations = {number}\n'
        )
        with pytest.raises(InputError, match=r"x\.toml, line 4: not TOML"):
            load(small_station.parent / "x.toml")
    edit(small_station, 'unit = "mm"', f'unit = "mm"\nx = {number}')
    with pytest.raises(InputError, match=r"station\.toml, line 5: not TOML"):
        Station.load(small_station)


def test_byte_order_marks_are_accepted_in_every_file(small_station: Path) -> None:
    from malus.studio import settings
    from malus.studio.document import StationDocument

    mark = b"\xef\xbb\xbf"
    small_station.write_bytes(mark + small_station.read_bytes())
    assert Station.load(small_station).describe()["unit"] == "mm"
    document = StationDocument.read(small_station)
    document.set("station", "name", "marked")
    document.write(document.digest)
    assert Station.load(small_station).describe()["name"] == "marked"
    for table, load in (("campaign", Campaign.load), ("object", Object.load)):
        file = small_station.parent / f"{table}.toml"
        file.write_bytes(mark + f'[{table}]\nstations = ["station.toml"]\n'.encode())
        load(file)
    options = settings.file_of(small_station)
    options.write_bytes(mark + b"[refine]\niterations = 3\n")
    settings.change(small_station, "fusion.method", None)
    assert settings.options_of(small_station).to_dict()["refine"]["iterations"] == 3


def test_studio_refuses_files_in_which_a_table_stands_twice(tmp_path: Path) -> None:
    """tomlkit reads this one, and failed when it was changed."""
    from malus.studio.document import StationDocument

    text = "[camera.a.b.c]\n[camera.x]\n[camera.a.d]\n[other]\n[camera.a.b.c]\n"
    with pytest.raises(InputError, match=r"station\.toml: not valid TOML .*camera.* twice"):
        StationDocument(tmp_path / "station.toml", text).set("camera", "params", [1.0])


@pytest.mark.parametrize("name", ["a\\nv 1 2 3", "a\\rb", "\\u001b[31mred", "a\\u0001", "a\\u007f"])
def test_names_are_one_line_without_control_characters(small_station: Path, work: Path, name: str) -> None:
    """A second line of a name became a vertex of OBJ files, which shifted all triangles. XML cannot hold control characters."""
    edit(small_station, 'name = "small"', f'name = "{name}"')
    expect(small_station, work, 2, "station.toml, line 3: [station].name: has", "expected")
    (small_station.parent / "o.toml").write_text(f'[object]\nname = "{name}"\nstations = ["station.toml"]\n')
    with pytest.raises(InputError, match=r"object\.name = .* expected one line"):
        Object.load(small_station.parent / "o.toml")


def test_catalog_entries_may_have_line_breaks_but_no_control_characters(small_station: Path, work: Path) -> None:
    edit(small_station, 'maker = "unknown mason"', 'description = """two\nlines\tand a tab"""\nmaker = "unknown mason"')
    assert Station.load(small_station).describe()["object"]["description"] == "two\nlines\tand a tab"
    edit(small_station, "unknown mason", "unknown\\u0001mason")
    expect(small_station, work, 2, "[object].maker: has control characters")


def test_file_names_that_are_not_utf8_are_refused(small_station: Path, tmp_path: Path) -> None:
    """A byte that is not UTF-8: in the station's folder, in an image's name, in the current folder, and for `Station.load`."""
    strange = tmp_path / os.fsdecode(b"st\xffange")
    small_station.parent.rename(strange)
    images = tmp_path / "images"
    images.mkdir()
    (images / os.fsdecode(b"pol\xff_000.tif")).write_bytes(b"")
    for arguments in (
        ("run", strange / "station.toml", "-o", tmp_path / "work"),
        ("check", strange / "station.toml"),
        ("import", images, "-o", tmp_path / "new.toml"),
        ("options", strange),
    ):
        outcome = malus(*arguments, cwd=tmp_path)
        assert outcome.code == 2, outcome
        assert "\\xff" in outcome.err and "not in UTF-8" in outcome.err
    outcome = malus("check", "station.toml", cwd=strange)
    assert outcome.code == 2 and "not in UTF-8" in outcome.err
    with pytest.raises(InputError, match="not in UTF-8"):
        Station.load(strange / "station.toml")


def test_workspaces_that_cannot_be_created_are_refused(small_station: Path, tmp_path: Path) -> None:
    """A name that is too long and circular links end in a message, not in an abort or a traceback."""
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    for folder in (tmp_path / ("x" * 300), tmp_path / "a" / "work"):
        for program, run_words in ((malus, ("run",)), (malus_station, ())):
            outcome = program(*run_words, small_station, "-o", folder, "--quiet")
            assert outcome.code == 2, outcome
            assert str(folder) in outcome.err
            assert "Traceback" not in outcome.err
    assert malus_station(small_station, "-o", "", "--quiet").code == 2


@pytest.mark.parametrize("name", ["x" * 300, "circle/file"])
@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("pol/pol_030.tif", "NAME", "images"),
        (ANGLES, ANGLES + '\nmask = "NAME"', "mask"),
        (ANGLES, ANGLES + '\nresponse = "NAME"', "response"),
        ("[camera]", '[optics]\nreflection = "NAME"\n\n[camera]', "reflection"),
        ("dense/cloud.ply", "NAME", "cloud"),
    ],
)
def test_paths_that_cannot_be_examined_are_named_with_their_field(
    small_station: Path, work: Path, old: str, new: str, field: str, name: str
) -> None:
    """The path's name is too long, or its links are circular."""
    (small_station.parent / "circle").symlink_to("circle")
    edit(small_station, old, new.replace("NAME", name))
    outcome = malus_station(small_station, "-o", work, "--quiet")
    assert outcome.code == 2, outcome
    assert f"].{field}" in outcome.err and name in outcome.err
    assert "too long" in outcome.err or "symbolic links" in outcome.err


def test_unknown_key_suggests_the_nearest_one(small_station: Path, work: Path) -> None:
    edit(small_station, "white_level", "whitelevel")
    expect(small_station, work, 2, "whitelevel", "white_level")


def test_wrong_type(small_station: Path, work: Path) -> None:
    edit(small_station, "frames_averaged = 16", 'frames_averaged = "many"')
    expect(small_station, work, 2, "frames_averaged", "many")


def test_fewer_than_three_distinct_angles(small_station: Path, work: Path) -> None:
    # 180 degrees is 0 again, so these are two distinct angles, with several exposures each.
    edit(small_station, ANGLES, "angles_deg = [0, 180, 90, 270, 0, 90]")
    expect(small_station, work, 3, "angle", "three")


def test_number_of_angles_differs_from_images(small_station: Path, work: Path) -> None:
    edit(small_station, ANGLES, "angles_deg = [0, 30, 60, 90]")
    expect(small_station, work, 2, "angles_deg", "6", "4")


def test_images_of_different_size(small_station: Path, work: Path) -> None:
    path = small_station.parent / "pol" / "pol_060.tif"
    tifffile.imwrite(path, tifffile.imread(path)[:-1])
    expect(small_station, work, 2, "pol_060.tif", "200", "159", "160")


def test_missing_image(small_station: Path, work: Path) -> None:
    (small_station.parent / "pol" / "pol_060.tif").unlink()
    expect(small_station, work, 2, "pol_060.tif")


@pytest.mark.parametrize("content", ["empty", "truncated", "text"])
def test_unreadable_image(small_station: Path, work: Path, content: str) -> None:
    path = small_station.parent / "pol" / "pol_060.tif"
    data = path.read_bytes()
    path.write_bytes({"empty": b"", "truncated": data[: len(data) // 2], "text": b"this is not an image" * 50}[content])
    expect(small_station, work, 2, "pol_060.tif")


def test_mask_of_another_size(small_station: Path, work: Path) -> None:
    tifffile.imwrite(small_station.parent / "mask.tif", np.full((100, 100), 255, np.uint8))
    edit(small_station, "white_level = 16383", 'white_level = 16383\nmask = "mask.tif"')
    expect(small_station, work, 2, "mask.tif", "100", "200")


def test_all_saturated(small_station: Path, work: Path) -> None:
    for path in (small_station.parent / "pol").glob("*.tif"):
        tifffile.imwrite(path, np.full((160, 200), 16383, np.uint16))
    # Five images are to be registered to the first one, and none has any detail to register by: one warning each.
    expect(small_station, work, 3, "saturated", warnings=5)


def _write_cloud(station: Path, points: np.ndarray) -> None:
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    (station.parent / "dense" / "cloud.ply").write_bytes(header.encode() + points.astype("<f4").tobytes())


def test_cloud_misses_the_view(small_station: Path, work: Path) -> None:
    _write_cloud(small_station, np.random.default_rng(0).normal(0, 1, (1000, 3)) + [5000, 0, 0])
    expect(small_station, work, 3, "cloud")


def test_nan_in_the_cloud(small_station: Path, work: Path) -> None:
    points = np.random.default_rng(0).normal(0, 1, (1000, 3))
    points[17, 1] = np.nan
    _write_cloud(small_station, points)
    expect(small_station, work, 2, "cloud.ply", "17")


def test_ply_claims_four_billion_vertices(small_station: Path, work: Path) -> None:
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    (small_station.parent / "dense" / "cloud.ply").write_bytes(header.encode() + struct.pack("<9f", *range(9)))
    expect(small_station, work, 2, "cloud.ply", "4000000000")


def test_unknown_option(small_station: Path, work: Path) -> None:
    expect(small_station, work, 2, "height", "smothness", arguments=("--set", "height.smothness=1"))


def test_option_out_of_range(small_station: Path, work: Path) -> None:
    expect(small_station, work, 2, "grid.grid_px", arguments=("--set", "grid.grid_px=-4"))


def test_unknown_argument(small_station: Path, work: Path) -> None:
    for program in (malus, malus_station):
        run_words = ("run",) if program is malus else ()
        outcome = program(*run_words, small_station, "-o", work, "--no-such-thing")
        assert outcome.code == 2, outcome
        assert "--no-such-thing" in outcome.err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_output_not_writable(small_station: Path, tmp_path: Path) -> None:
    (tmp_path / "closed").mkdir(mode=0o500)
    expect(small_station, tmp_path / "closed" / "work", 2, "closed")


def test_output_is_a_file(small_station: Path, work: Path) -> None:
    work.write_text("")
    for program in (malus, malus_station):
        run_words = ("run",) if program is malus else ()
        outcome = program(*run_words, small_station, "-o", work)
        assert outcome.code == 2, outcome
        assert "work" in outcome.err


@pytest.fixture
def small_disk(tmp_path: Path):
    """A file system of 1 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", folder], capture_output=True)
    if done.returncode != 0:
        pytest.skip("mounting a small disk is not permitted here")
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_disk_full(small_station: Path, small_disk: Path) -> None:
    expect(small_station, small_disk / "work", 5, "space")


def test_cloud_points_at_one_place_count_once(small_station: Path, work: Path) -> None:
    """A cloud in meters in front of a camera in millimeters shrinks like this: many points fall on few places of the image."""
    cloud = small_station.parent / "dense/cloud.ply"
    station = Station.load(small_station)
    camera, depth = station.describe()["camera"], float(np.median(_core.check_picture(station._core, 1)[2][:, 2]))
    fx, fy, cx, cy = camera["params"]
    in_camera = np.array([(100 - cx) / fx, (80 - cy) / fy, 1]) * depth
    x, y, z = (in_camera - camera["translation"]) @ np.array(camera["rotation"])
    header = [
        "ply",
        "format ascii 1.0",
        "element vertex 100",
        *(f"property float {axis}" for axis in "xyz"),
        "end_header",
    ]
    cloud.write_text("\n".join([*header, *[f"{x} {y} {z}"] * 100, ""]))
    expect(small_station, work, 3, "100 of 100 points are visible on the object, in only ", "places", "at least 30")
