"""Seed corpora and dictionaries: small files of every kind, in one folder per target below the given folder, and beside it
TARGET.dict, the words of these files.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image
from stations import OBJECTS, STATIONS

from malus import Options, _core, synthetic

sys.path.append(str(Path(__file__).resolve().parents[1] / "python"))
from e57_pages import content_of
from test_import import METASHAPE
from test_raw import write_dng
from test_scans import write_e57, write_e57_with_normals, write_las

#: In every dictionary: numbers at and beyond the ends of their types, byte order mark, brackets.
WORDS = [
    b"1e999",
    b"-1e-999",
    b"nan",
    b"inf",
    b"4294967295",
    b"9223372036854775808",
    b"\xef\xbb\xbf",
    b"[[",
    b"]]",
    b"\0",
]
Seed = Callable[[str, str, bytes], None]
SEPARATOR = b"\n=====\n"
CAMERAS = b"1 PINHOLE 160 120 500 500 80 60\n2 OPENCV 160 120 500 500 80 60 .1 .01 0 0\n"
IMAGES = b"1 1 0 0 0 0 0 0 1 a.jpg\n80 60 1 20 30 -1\n2 .7 .7 0 0 1 2 3 2 b.jpg\n10 10 1\n"
POINTS = b"1 0 0 5 255 0 0 .5 1 0 2 0\n"


def main(folder: Path) -> None:
    """Write seeds and dictionaries."""
    seeds: defaultdict[str, list[bytes]] = defaultdict(list)

    def seed(target: str, name: str, content: bytes) -> None:
        (folder / target).mkdir(parents=True, exist_ok=True)
        (folder / target / name).write_bytes(content)
        seeds[target].append(content)

    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        station = synthetic.write_station(work / "station", 120, 120)
        for name, text in STATIONS.items():
            for target in ("station", "toml", "document"):
                seed(target, name, text.encode())
        for name, text in OBJECTS.items():
            seed("object", name, text.encode())
            seed("photos", name, text[text.index("[photos]") :].partition("[options]")[0].encode())
        options = b'fusion = "grid"\n[refine]\nevidence = true\n'
        seed("toml", "options", options)
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
                if kind == "png":
                    seed("painted", name, (work / "i.png").read_bytes())
        _core.write_float_tiff(str(work / "f.tif"), gray.astype(np.float32))
        seed("image", "float.tif", (work / "f.tif").read_bytes())
        exif = Image.Exif()
        exif.get_ifd(34665).update({37386: 50.0, 41486: 1000.0, 41488: 2, 33434: 0.01})
        Image.fromarray(gray).save(work / "e.jpg", exif=exif)
        seed("exif", "tags", (work / "e.jpg").read_bytes())
        write_dng(work / "r.dng", np.linspace(0, 1, 80 * 64).reshape(64, 80))
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
    _texts(seed)
    _scans(seed)
    keys = json.dumps(Options().to_dict()).encode()
    for target in ("toml", "campaign", "object"):
        seeds[target].append(keys)
    for target, contents in seeds.items():
        (folder / f"{target}.dict").write_bytes(_dictionary(contents))


def _texts(seed: Seed) -> None:
    """Seeds of COLMAP models, patterns of names, tables and notes beside images, and records."""
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
    matrix = {"filename": "mask.png", "mueller_psa": (np.outer([1, 1, 0, 0], [1, 1, 0, 0]) / 2).tolist()}
    seed("sidecar", "matrix", json.dumps(matrix).encode())
    seed("sidecar", "angle", json.dumps({"filename": "mask.png", "polarizer_angle": 45}).encode())
    seed("campaign", "plain", b'[campaign]\nname = "c"\nstations = ["*.toml"]\n[options]\nfusion = "grid"\n')
    seed("metashape", "project", METASHAPE.encode())
    seed("record", "plain", b'{"a": 1, "checksum": ""}')
    seed("response", "numbers", b"# DN, linear\n0 0\n128 0.2\n255 1\n")
    seed("response", "one column", b"0\n0.5\n1\n")


def _scans(seed: Seed) -> None:
    """Seeds of LAS and E57 files; of the latter without checksums (see parsers.py)."""
    chance = np.random.default_rng(0)
    points, normals = chance.uniform(-9, 9, (20, 3)), np.tile([0.0, 0.0, 1.0], (20, 1))
    colors = chance.integers(0, 256, (20, 3)).astype(np.uint8)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "cloud"
        for suffix in (".las", ".laz"):
            write_las(path.with_suffix(suffix), points, normals)
            seed(suffix[1:], suffix[1:], path.with_suffix(suffix).read_bytes())
            write_las(path.with_suffix(suffix), points, normals, colors)
            seed(suffix[1:], "colored", path.with_suffix(suffix).read_bytes())
        write_e57(path, points)
        seed("e57", "posed", content_of(path.read_bytes()))
        write_e57(path, points, colors)
        seed("e57", "colored", content_of(path.read_bytes()))
        write_e57_with_normals(path, points, normals, chance.integers(0, 3, 20))
        seed("e57", "normals", content_of(path.read_bytes()))


def _dictionary(contents: list[bytes]) -> bytes:
    """A dictionary for libFuzzer: the words of these contents."""
    words = {word for content in contents for word in re.findall(rb"[A-Za-z_][\w:.-]{2,40}", content)}
    return b"".join(b'"%b"\n' % b"".join(b"\\x%02X" % byte for byte in word) for word in [*sorted(words), *WORDS])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
