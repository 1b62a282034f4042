"""The response curve that image files declare, compared with the one in the station file."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms, PngImagePlugin

from conftest import edit, malus_here
from malus.encoding import doubts, encoding_of, mosaic_doubts

PIXELS = np.arange(256, dtype=np.uint8).reshape(16, 16)


def profile_of_exponent(exponent: float) -> bytes:
    """A gray ICC profile of version 2 whose curve is a power law."""
    curve = b"curv\0\0\0\0" + (1).to_bytes(4, "big") + round(exponent * 256).to_bytes(2, "big") + b"\0\0"
    white = b"XYZ \0\0\0\0" + b"".join(round(x * 65536).to_bytes(4, "big") for x in (0.9642, 1.0, 0.8249))
    text = b"gray of a power\0"
    words = b"desc\0\0\0\0" + len(text).to_bytes(4, "big") + text + bytes(4 + 4 + 2 + 1 + 67)
    tags, body = b"", b""
    start = 128 + 4 + 3 * 12
    for name, content in ((b"desc", words), (b"wtpt", white), (b"kTRC", curve)):
        content += bytes(-len(content) % 4)
        tags += name + (start + len(body)).to_bytes(4, "big") + len(content).to_bytes(4, "big")
        body += content
    head = bytearray(128)
    head[0:4] = (start + len(body)).to_bytes(4, "big")
    head[8:12], head[12:24], head[36:40] = b"\x02\x40\0\0", b"mntrGRAYXYZ ", b"acsp"
    head[68:80] = b"".join(round(x * 65536).to_bytes(4, "big") for x in (0.9642, 1.0, 0.8249))
    return bytes(head) + (3).to_bytes(4, "big") + tags + body


def srgb() -> bytes:
    return bytes(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())


def saved(path: Path, **how: object) -> Path:
    Image.fromarray(np.stack([PIXELS] * 3, -1) if how.pop("color", False) else PIXELS).save(path, **how)
    return path


def test_profiles_say_whether_files_are_linear(tmp_path: Path) -> None:
    encoded = encoding_of(saved(tmp_path / "a.jpg", color=True, icc_profile=srgb()))
    assert encoded is not None and not encoded.is_linear and "sRGB" in encoded.source
    linear = encoding_of(saved(tmp_path / "b.png", icc_profile=profile_of_exponent(1.0)))
    assert linear is not None and linear.is_linear and "gray of a power" in linear.source
    assert encoding_of(saved(tmp_path / "c.png", icc_profile=profile_of_exponent(1.3))) is None
    assert encoding_of(saved(tmp_path / "d.png", icc_profile=b"no profile")) is None
    tifffile.imwrite(tmp_path / "e.tif", PIXELS.astype(np.uint16), iccprofile=profile_of_exponent(1.0))
    developed = encoding_of(tmp_path / "e.tif")
    assert developed is not None and developed.is_linear


def test_metadata_other_than_profiles_say_whether_files_are_linear(tmp_path: Path) -> None:
    gamma = PngImagePlugin.PngInfo()
    gamma.add(b"gAMA", (100000).to_bytes(4, "big"))
    linear = encoding_of(saved(tmp_path / "a.png", pnginfo=gamma))
    assert linear is not None and linear.is_linear
    exif = Image.Exif()
    exif[271] = "Camera"
    camera = encoding_of(saved(tmp_path / "b.jpg", exif=exif))
    assert camera is not None and not camera.is_linear
    raw = encoding_of(tmp_path / "c.NEF")
    assert raw is not None and raw.is_linear


def test_files_without_metadata_have_no_known_encoding(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.png", "c.tif"):
        assert encoding_of(saved(tmp_path / name)) is None
    assert encoding_of(tmp_path / "missing.png") is None
    (tmp_path / "text.png").write_text("no image")
    assert encoding_of(tmp_path / "text.png") is None


def test_doubts_where_file_and_station_file_disagree(tmp_path: Path) -> None:
    encoded = [saved(tmp_path / f"{k}.jpg", color=True, icc_profile=srgb()) for k in range(3)]
    linear = [saved(tmp_path / "linear.png", icc_profile=profile_of_exponent(1.0))]
    ((_, message, suggestion),) = doubts(encoded, "linear")
    assert "0.jpg and 2 more" in message and "sRGB" in message and 'response = "srgb"' in suggestion
    for response in ("srgb", "gamma:2.2"):
        assert doubts(encoded, response) == []
        ((_, message, suggestion),) = doubts(linear, response)
        assert "linear.png" in message and 'response = "linear"' in suggestion
    assert doubts(linear, "linear") == doubts(linear, "curve.csv") == doubts(encoded, "gamma:1.3") == []


def test_the_response_that_fits_is_suggested(tmp_path: Path) -> None:
    """RAW developers write gamma 1.8 (ProPhoto RGB) and 2.2 (Adobe RGB), which are powers, unlike the curve of sRGB."""
    for exponent, response in ((1.8, "gamma:1.8"), (2.2, "gamma:2.2")):
        developed = [saved(tmp_path / f"{exponent}.png", icc_profile=profile_of_exponent(exponent))]
        ((_, _, suggestion),) = doubts(developed, "linear")
        assert f'response = "{response}"' in suggestion
        assert doubts(developed, response) == []
    ((check, message, suggestion),) = doubts([tmp_path / "1.8.png"], "srgb")
    assert check == "curve"  # which the light does not tell
    assert "another encoding" in message and "gray of a power" in message and 'response = "gamma:1.8"' in suggestion
    assert doubts([tmp_path / "2.2.png"], "srgb") == []
    gamma = PngImagePlugin.PngInfo()
    gamma.add(b"gAMA", (55556).to_bytes(4, "big"))
    ((_, _, suggestion),) = doubts([saved(tmp_path / "entry.png", pnginfo=gamma)], "linear")
    assert 'response = "gamma:1.8"' in suggestion


@pytest.fixture
def with_profile(small_station: Path) -> Path:
    """The station's images are linear but carry a profile of a display encoding."""
    for path in (small_station.parent / "pol").iterdir():
        tifffile.imwrite(path, tifffile.imread(path), iccprofile=profile_of_exponent(2.2))
    return small_station


def test_check_reports_a_contradicting_profile(with_profile: Path, tmp_path: Path) -> None:
    outcome = malus_here("check", with_profile)
    assert outcome.code == 0, outcome.err
    assert "images are encoded for a display according to their files" in outcome.out
    edit(with_profile, "[polarized]", '[polarized]\nresponse = "gamma:2.2"')
    assert "encoded for a display" not in malus_here("check", with_profile).out


def test_a_profile_does_not_overrule_the_response_found_in_the_images(with_profile: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    outcome = malus_here("fuse", with_profile, "-o", work, "--fusion", "grid")
    assert outcome.code == 0, outcome.err
    findings = (work / "evidence/findings.json").read_text()
    assert "images are encoded for a display according to their files" in findings
    assert "the measured brightness shows that this is right" in findings
    assert "encoded for a display" not in io.StringIO(outcome.err).read()


def test_a_mosaic_in_a_jpeg_file_is_doubted(small_station: Path, tmp_path: Path) -> None:
    lossy, exact = saved(tmp_path / "m.jpg"), saved(tmp_path / "m.png")
    assert mosaic_doubts([lossy], False) == mosaic_doubts([exact], True) == []
    ((_, message, suggestion),) = mosaic_doubts([lossy], True)
    assert "m.jpg is a JPEG file" in message and "PNG" in suggestion
    images = sorted((small_station.parent / "pol").iterdir())
    mosaic = tifffile.imread(images[0]).astype(np.float32)
    Image.fromarray(np.rint(255 * mosaic / mosaic.max()).astype(np.uint8)).save(small_station.parent / "m.jpg")
    text = re.sub(r"(?m)^(angles_deg|white_level|black_level) = .*\n", "", small_station.read_text())
    text = re.sub(r"(?m)^images = .*$", 'images = ["m.jpg"]\nmosaic = [[90, 45], [135, 0]]', text)
    small_station.write_text(text)
    outcome = malus_here("check", small_station)
    assert "m.jpg is a JPEG file, whose compression mixes" in outcome.out, outcome.err
