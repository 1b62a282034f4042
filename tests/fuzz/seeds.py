"""Seed corpora: small files of every kind, in one folder per target below the given folder."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image

from malus import _core, synthetic

SEPARATOR = b"\n=====\n"
CAMERAS = b"1 PINHOLE 160 120 500 500 80 60\n2 OPENCV 160 120 500 500 80 60 .1 .01 0 0\n"
IMAGES = b"1 1 0 0 0 0 0 0 1 a.jpg\n80 60 1 20 30 -1\n2 .7 .7 0 0 1 2 3 2 b.jpg\n10 10 1\n"
POINTS = b"1 0 0 5 255 0 0 .5 1 0 2 0\n"


def main(folder: Path) -> None:
    """Write the seeds."""

    def seed(target: str, name: str, content: bytes) -> None:
        (folder / target).mkdir(parents=True, exist_ok=True)
        (folder / target / name).write_bytes(content)

    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        station = synthetic.write_station(work / "station", 120, 120)
        text = station.read_text(encoding="utf-8").replace("pol_030.tif", "pol_060.png")
        seed("station", "synthetic", text.encode())
        seed("toml", "station", text.encode())
        seed("toml", "options", b'fusion = "grid"\n[refine]\nevidence = true\n')
        seed("ply", "cloud", (station.parent / "cloud.ply").read_bytes()[:4000])
        head = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        faces = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
        seed("ply", "mesh", head + faces)
        seed("xyz", "named", b"# x y z r g b\n1 2 3 4 5 6\n7,8,9,10,11,12\n")
        seed("xyz", "plain", b"1 2 3 0 0 1\n4 5 6 0 1 0\n")
        gray = np.arange(48, dtype=np.uint8).reshape(6, 8)
        for kind in ("png", "jpg", "tif"):
            for name, image in (("gray", gray), ("color", np.dstack([gray] * 3))):
                Image.fromarray(image).save(work / f"i.{kind}")
                seed("image", f"{name}.{kind}", (work / f"i.{kind}").read_bytes())
                seed("exif", f"{name}.{kind}", (work / f"i.{kind}").read_bytes())
        _core.write_float_tiff(str(work / "f.tif"), gray.astype(np.float32))
        seed("image", "float.tif", (work / "f.tif").read_bytes())
        exif = Image.Exif()
        exif.get_ifd(34665).update({37386: 50.0, 41486: 1000.0, 41488: 2, 33434: 0.01})
        Image.fromarray(gray).save(work / "e.jpg", exif=exif)
        seed("exif", "tags", (work / "e.jpg").read_bytes())
        mosaic = [
            (50706, "B", 4, (1, 4, 0, 0), True),
            (33421, "H", 2, (2, 2), True),
            (33422, "B", 4, (0, 1, 1, 2), True),
        ]
        tifffile.imwrite(work / "r.dng", gray.astype(np.uint16), photometric=32803, extratags=mosaic, metadata=None)
        seed("raw", "mosaic.dng", (work / "r.dng").read_bytes())
        done = subprocess.run(
            [sys.executable, "-m", "malus.cli", "decompose", station, "-o", work / "out", "--quiet"], check=False
        )
        if done.returncode == 0:
            manifest = json.loads((work / "out/manifest.json").read_text(encoding="utf-8"))
            del manifest["station"]["says"]
            # Only one step and no parts that the parser skips: the fuzzer runs five times as many inputs per second as
            # with the whole manifest.
            manifest |= {"options": {}, "inputs": {}, "times": {}, "steps": {"zenith": manifest["steps"]["zenith"]}}
            seed("manifest", "decompose", json.dumps(manifest).encode())
    seed("colmap_text", "model", SEPARATOR.join([CAMERAS, IMAGES, POINTS]))
    counts = (2).to_bytes(8, "little")
    camera = (1).to_bytes(4, "little") * 2 + (160).to_bytes(8, "little") + (120).to_bytes(8, "little")
    seed("colmap_binary", "model", SEPARATOR.join([counts + camera + np.full(4, 80.0).tobytes(), counts, counts]))
    seed("colmap_map", "depth", b"4&3&1&" + np.ones(12, np.float32).tobytes())
    names = [b"pol_000.png", b"pol_45.png", b"a 90deg.png", b"angle-135.tif"]
    seed("names", "pattern", SEPARATOR.join([rb"pol_(\d+)\.", *names]))
    seed("names", "glob", SEPARATOR.join([b"*/[a-z]?l*/../*", *names]))
    seed("table", "commas", b"image,angle_deg,exposure_s\na.png,0,.1\nb.png,45,.1\n")
    seed("table", "semicolons", b"sep=;\nimage;angle\na.png;22,5\n")
    seed("sidecar", "polanalyser", json.dumps({"filename": "image.json", "polarizer_angle": 45}).encode())
    seed("campaign", "plain", b'[campaign]\nname = "c"\nstations = ["*.toml"]\n[options]\nfusion = "grid"\n')
    seed(
        "metashape",
        "camera",
        b'<document><chunk><sensors><sensor id="0"><calibration/></sensor></sensors></chunk></document>',
    )
    seed("record", "plain", b'{"a": 1, "checksum": ""}')
    for target in ("las", "e57"):
        seed(target, "header", {"las": b"LASF" + bytes(371), "e57": b"ASTM-E57" + bytes(2000)}[target])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
