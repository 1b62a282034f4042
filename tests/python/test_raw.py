"""RAW files, and the exposure settings in image files."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

import malus
from conftest import malus_here, malus_station
from malus import _core, raw
from malus._files import sha256_of
from malus.exif import exposure_doubts, mask_notes, tags_of
from malus.photogrammetry import front_end
from malus.photogrammetry.photos import describe_photo
from malus.report import CHECKS

BLACK, WHITE = 512, 16383
ANGLES = (0, 45, 90, 135)
SIZE = (48, 64)


def write_dng(path: Path, linear: np.ndarray, **changes: Any) -> None:
    """A DNG with an RGGB pattern (H×W, 0 … 1), and the EXIF tags that its main directory may hold."""
    exif = {"exposure": (1, 60), "iso": 100, "f_number": (8, 1), "focal": (50, 1)} | changes
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNGVersion
        (50707, "B", 4, (1, 1, 0, 0), True),  # DNGBackwardVersion
        (50708, "s", 0, "Malus test", True),  # UniqueCameraModel
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, (0, 1, 1, 2), True),  # CFAPattern
        (50714, "H", 1, BLACK, True),  # BlackLevel
        (50717, "H", 1, WHITE, True),  # WhiteLevel
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),  # ColorMatrix1
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # AsShotNeutral
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1
        (51041, "d", 2, (1 / 15000, (6 / 15000) ** 2), True),  # NoiseProfile
        (33434, "2I", 1, exif["exposure"], True),
        (33437, "2I", 1, exif["f_number"], True),
        (34855, "H", 1, exif["iso"], True),
        (37386, "2I", 1, exif["focal"], True),
    ]
    dn = np.rint(BLACK + linear * (WHITE - BLACK)).astype(np.uint16)
    tifffile.imwrite(path, dn, photometric=32803, extratags=tags, metadata=None, compression=None)


def scene(angle_deg: float) -> np.ndarray:
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    intensity = 0.2 + 0.004 * u + 0.003 * v
    return intensity * (1 + 0.2 * np.cos(2 * np.radians(angle_deg - 30)))


@pytest.fixture
def station(tmp_path: Path) -> Path:
    """Four DNG files of uniform polarization: degree 0.2, phase 30°."""
    for angle in ANGLES:
        write_dng(tmp_path / f"pol_{angle:03d}.dng", scene(angle))
    path = tmp_path / "station.toml"
    path.write_text('[polarized]\nimages = "."\n')
    return path


def test_raw_files_are_linear(station: Path, tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    result = malus.reconstruct(malus.Station.load(station), workspace=tmp_path / "work", until="zenith")
    assert result.degree is not None and result.phase_rad is not None and result.unpolarized is not None
    inside = (slice(4, -4), slice(4, -4))
    np.testing.assert_allclose(result.degree[inside], 0.2, atol=2e-3)
    np.testing.assert_allclose(np.degrees(result.phase_rad[inside]), 30, atol=0.3)
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    np.testing.assert_allclose(result.unpolarized[inside], (0.2 + 0.004 * u + 0.003 * v)[inside], atol=1e-3)


def test_rims_of_highlights_count_as_saturated(tmp_path: Path) -> None:
    """A sample that is clipped is darker than the light, and so is every pixel that is interpolated from it."""
    pytest.importorskip("rawpy")
    light = np.full(SIZE, 0.3)
    light[20:25, 30:37] = 1.0
    write_dng(tmp_path / "pol_000.dng", light)
    pixels = raw.linear_image(tmp_path / "pol_000.dng")
    assert np.all((np.abs(pixels - 0.3) < 1e-3) | (pixels == 1) | (pixels >= 0.995))
    near = pixels[18:27, 28:39]
    assert np.all(pixels[20:25, 30:37] >= 0.995) and 100 > np.count_nonzero(near[..., 1] >= 0.995) > 35
    assert np.all(pixels[:17] < 0.4) and np.all(pixels[:, 41:] < 0.4)


def test_images_are_developed_again_only_if_their_content_changed(station: Path, tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    work = tmp_path / "work"

    def decompose() -> dict[str, int]:
        malus.reconstruct(malus.Station.load(station), workspace=work, until="zenith")
        return {path.name: path.stat().st_mtime_ns for path in (work / "raw").iterdir()}

    before = decompose()
    assert len(before) == len(ANGLES)
    assert decompose() == before
    write_dng(tmp_path / "pol_000.dng", scene(0) * 0.999)
    after = decompose()
    assert len(set(after.items()) - set(before.items())) == 1
    assert len(after) == len(ANGLES), "the image of the file that was replaced is removed"


@pytest.mark.parametrize("damage", ["flipped", "emptied"])
def test_damaged_developed_images_are_developed_again(station: Path, tmp_path: Path, damage: str) -> None:
    pytest.importorskip("rawpy")
    images = [tmp_path / f"pol_{angle:03d}.dng" for angle in ANGLES]
    for _ in range(2):
        image = raw.develop(images, "all", tmp_path / "raw").images[0]
        content = image.read_bytes()
        image.write_bytes(bytes([content[0], *(255 - byte for byte in content[1:])]) if damage == "flipped" else b"")
    assert raw.develop(images, "all", tmp_path / "raw").images[0].read_bytes() == content


def test_the_bytes_that_are_hashed_are_developed(station: Path, tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    path = tmp_path / "pol_000.dng"
    content, pixels = path.read_bytes(), raw.linear_image(path)
    write_dng(path, scene(0) * 0.5)
    np.testing.assert_array_equal(raw.linear_image(path, content), pixels)


def test_the_lens_of_raw_files_is_looked_for_among_the_photos(tmp_path: Path) -> None:
    """A station without [camera]: its first image may be a RAW file."""
    pytest.importorskip("rawpy")
    write_dng(tmp_path / "pol_000.dng", scene(0))
    same = describe_photo(tmp_path / "pol_000.dng", "view.jpg")
    assert (same.height, same.width) == SIZE
    other = replace(same, name="other.jpg", focal_px=123.0)
    said = {"images": [str(tmp_path / "pol_000.dng")]}
    for photos, name in (([other, same], "view.jpg"), ([other], None)):
        model: Any = SimpleNamespace(images={photo.name: None for photo in photos})
        assert front_end._photo_of_same_camera(said, photos, model, SIZE, lambda _level, _message: None) == name


def as_raw(station: Path) -> None:
    """Replace the images of a station by RAW files."""
    for path in sorted((station.parent / "pol").iterdir()):
        write_dng(path.with_suffix(".dng"), tifffile.imread(path) / WHITE)
    station.write_text(station.read_text().replace(".tif", ".dng").replace(f"white_level = {WHITE}\n", ""))


@pytest.mark.parametrize("kind", ["RAW", "of another encoding"])
def test_a_result_in_memory_is_saved_without_computing_it_again(
    small_station: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """The folder of the developed images, and findings that stood there twice, made every step of the result another one."""
    if kind == "RAW":
        pytest.importorskip("rawpy")
        as_raw(small_station)
    else:
        profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
        for path in (small_station.parent / "pol").iterdir():
            tifffile.imwrite(path, tifffile.imread(path), iccprofile=profile)
    result = malus.reconstruct(malus.Station.load(small_station), malus.Options(fusion="grid"))
    run, saved = _core.reconstruct, []

    def watched(*arguments: Any, **how: Any) -> Any:
        saved.append(run(*arguments, **how | {"keep_maps": True}))
        return saved[-1]

    monkeypatch.setattr(_core, "reconstruct", watched)
    result.save(tmp_path / "work")
    (outcome,) = saved
    assert np.shares_memory(outcome["degree"], result.degree) and np.shares_memory(outcome["depth"], result.depth)
    workspace = malus.Workspace(tmp_path / "work")
    messages = [finding["message"] for finding in workspace.findings]
    assert len(set(messages)) == len(messages) and workspace.manifest["warnings"] == result.warnings
    missing = [name for name in workspace.manifest["inputs"] if not (small_station.parent / name).is_file()]
    assert not missing, "the manifest names files that are gone"


def test_the_archive_has_the_raw_files_that_were_developed(small_station: Path, tmp_path: Path) -> None:
    for package in ("rawpy", "rocrate", "bagit"):
        pytest.importorskip(package)
    as_raw(small_station)
    work = tmp_path / "work"
    malus.reconstruct(malus.Station.load(small_station), malus.Options(fusion="grid"), workspace=work)
    with zipfile.ZipFile(malus.export(work, "archive")) as file:
        graph = json.loads(file.read("small/data/ro-crate-metadata.json"))["@graph"]
    stated = {entity["@id"]: entity.get("sha256") for entity in graph if entity["@type"] == "File"}
    packed = small_station.parent / "pol/pol_030.dng"
    assert stated["inputs/pol/pol_030.dng"] == sha256_of(packed)
    assert malus.Workspace(work).manifest["inputs"]["pol/pol_030.dng"] == sha256_of(packed)
    assert {name for name, digest in stated.items() if not digest} == {
        "metadata/dublin_core.xml",
        "results/manifest.json",
    }
    packed.write_bytes(packed.read_bytes()[:-1] + b"x")
    with pytest.raises(malus.InputError, match=r"pol_030\.dng: was changed since"):
        malus.export(work, "archive")


def test_noise_comes_from_the_file(station: Path, tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    station.write_text(station.read_text() + 'channel = "green"\n')
    malus.reconstruct(malus.Station.load(station), workspace=tmp_path / "work", until="zenith")
    noise = json.loads((tmp_path / "work/manifest.json").read_text())["steps"]["polarization"]["notes"]["noise"]
    assert noise["full_well_e"] == pytest.approx(15000, rel=1e-6)
    assert noise["read_noise_e"] == pytest.approx(6, rel=1e-6)


def test_a_chosen_channel_gives_one_plane(station: Path, tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    station.write_text(station.read_text() + 'channel = "green"\n')
    malus.reconstruct(malus.Station.load(station), workspace=tmp_path / "work", until="zenith")
    for path in (tmp_path / "work/raw").iterdir():
        assert tifffile.imread(path).shape == SIZE


def test_executable_says_what_develops_raw_files(station: Path, tmp_path: Path) -> None:
    outcome = malus_station(station, "-o", tmp_path / "work", "--until", "zenith")
    assert outcome.code == 2
    assert "pol_000.dng is a camera's RAW file" in outcome.err
    assert "malus[raw]" in outcome.err


def test_levels_are_refused_for_raw_files(station: Path) -> None:
    station.write_text(station.read_text() + "white_level = 16383\n")
    with pytest.raises(malus.InputError, match="white_level: is not for RAW files"):
        malus.Station.load(station)


def test_damaged_raw_is_an_input_error(station: Path, tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    (tmp_path / "pol_045.dng").write_bytes(b"II*\0 not a DNG")
    outcome = malus_here("decompose", station, "-o", tmp_path / "work")
    assert outcome.code == 2
    assert "pol_045.dng: not a RAW file that LibRaw can read" in outcome.err
    assert "Traceback" not in outcome.err


def test_a_header_that_states_more_pixels_than_the_file_can_hold_takes_no_memory(tmp_path: Path) -> None:
    """LibRaw takes memory for all pixels that a header states: half a gigabyte for this small file."""
    pytest.importorskip("rawpy")
    path = tmp_path / "stated.dng"
    write_dng(path, np.zeros((24, 32), np.uint16))
    with tifffile.TiffFile(path, mode="r+b") as file:
        for tag, stated in (("ImageWidth", 23901), ("ImageLength", 11554)):
            file.pages[0].tags[tag].overwrite(stated)
    for read in (raw.image_size, raw.linear_image):
        with pytest.raises(
            malus.InputError, match=r"stated.dng: states 23901 x 11554 pixels, more than its \d+ bytes can hold"
        ):
            read(path)


def test_missing_library_is_named(station: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rawpy", None)
    with pytest.raises(malus.ExternalError, match=r"rawpy, which is not installed.*malus\[raw\]"):
        malus.reconstruct(malus.Station.load(station), workspace=tmp_path / "work", until="zenith")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"exposure": (1, 30)}, "exposure time 1/30 s, but pol_000.dng has 1/60 s"),
        ({"iso": 200}, "ISO sensitivity 200, but pol_000.dng has 100"),
        ({"f_number": (11, 1)}, "aperture f/ 11, but pol_000.dng has 8"),
        ({"focal": (55, 1)}, "focal length 55 mm, but pol_000.dng has 50 mm"),
    ],
)
def test_settings_that_changed_are_named(station: Path, tmp_path: Path, change: dict[str, Any], message: str) -> None:
    write_dng(tmp_path / "pol_090.dng", scene(90), **change)
    for command in (["check", station], ["decompose", station, "-o", tmp_path / "work"]):
        outcome = malus_here(*command)
        assert outcome.code == 2, outcome.out
        assert f"pol_090.dng: {message}" in outcome.err


def test_settings_in_raw_files_that_are_not_tiff_are_compared(tmp_path: Path) -> None:
    """Olympus writes TIFF with another number in its header; CR3, RAF and RW2 are other formats altogether."""
    for angle in ANGLES:
        path = tmp_path / f"pol_{angle:03d}.orf"
        write_dng(path, scene(angle), exposure=(1, 30 if angle == 90 else 60))
        path.write_bytes(path.read_bytes().replace(b"II*\0", b"IIRO", 1))
        assert tags_of(path) == {}
    (tmp_path / "station.toml").write_text('[polarized]\nimages = "."\n')
    with pytest.raises(malus.InputError, match=r"pol_090\.orf: exposure time 1/30 s, but pol_000\.orf has 1/60 s"):
        malus.check(malus.Station.load(tmp_path / "station.toml"))


def test_jpeg_settings_are_compared_too(tmp_path: Path) -> None:
    from PIL.TiffImagePlugin import IFDRational

    for index, angle in enumerate(ANGLES):
        exif = Image.Exif()
        exif[34665] = {33434: IFDRational(1, 100 if index else 50)}
        Image.fromarray(np.full(SIZE, 100, np.uint8)).save(tmp_path / f"pol_{angle}.jpg", exif=exif)
    (tmp_path / "station.toml").write_text('[polarized]\nimages = "."\n')
    with pytest.raises(malus.InputError, match=r"pol_45\.jpg: exposure time 1/100 s, but pol_0\.jpg has 1/50 s"):
        malus.check(malus.Station.load(tmp_path / "station.toml"))


def test_exposure_times_of_files_are_compared_with_the_stated_ones(tmp_path: Path) -> None:
    from PIL.TiffImagePlugin import IFDRational

    images = []
    for index, part in enumerate((60, 15, 60, 15)):
        exif = Image.Exif()
        exif[34665] = {33434: IFDRational(1, part)}
        images.append(tmp_path / f"{index}.jpg")
        Image.fromarray(np.full(SIZE, 100, np.uint8)).save(images[-1], exif=exif)
    images.insert(0, tmp_path / "silent.jpg")
    Image.fromarray(np.full(SIZE, 100, np.uint8)).save(images[0])
    tags = [tags_of(path) for path in images]
    assert exposure_doubts(images, tags, [1 / 64, 1 / 64, 1 / 16, 1 / 64, 1 / 16]) == []
    assert exposure_doubts(images, tags, None) == exposure_doubts([], [], [1.0]) == []
    ((check, message, suggestion),) = exposure_doubts(images, tags, [1, 4, 1, 4, 1])
    assert check in CHECKS and "order of the images" in suggestion
    assert (
        message
        == "1.jpg was exposed 4 times as long as 0.jpg according to the files, but 0.25 times according to exposure_s"
    )


def test_a_mask_that_viewers_do_not_turn_with_the_images_is_noted(tmp_path: Path) -> None:
    """A mask that was drawn on the turned picture has the same size as the pixels that are stored."""
    photo, mask, turned = tmp_path / "pol_000.jpg", tmp_path / "mask.png", Image.Exif()

    def noted(orientation: int, size: tuple[int, int], **of_mask: Any) -> list[tuple[str, str, str]]:
        turned[274] = orientation
        Image.new("L", size).save(photo, exif=turned)
        Image.new("L", size).save(mask, **of_mask)
        return mask_notes([photo], mask)

    ((check, message, suggestion),) = noted(3, (60, 40))
    assert check in CHECKS and "pol_000.jpg turned by 180°" in message and "mask.png" in message
    assert "--overlay" in suggestion
    assert noted(3, (60, 40), exif=turned) == noted(1, (60, 40)) == []
    assert noted(6, (60, 40)) == [], "a mask drawn on the picture turned by 90° would have 40 x 60 pixels"
    assert "turned by 90°" in noted(6, (40, 40))[0][1]
    assert mask_notes([photo], None) == mask_notes([], mask) == []
