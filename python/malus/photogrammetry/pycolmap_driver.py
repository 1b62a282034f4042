"""Runs the commands of the program `colmap` that malus uses with the Python package pycolmap.

This is a separate program, since some calls of pycolmap end the process:

    python -m malus.photogrammetry.pycolmap_driver COMMAND --option value …

Commands, options and their meaning are those of COLMAP 3.8. The driver imports nothing of malus: it can run as a plain
file, starts faster and loads no other native library.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def _named(group: str, *paths: str) -> dict[str, str]:
    """Paths of attributes in pycolmap, by the names of the options in COLMAP 3.8: "Mapper.x" for "x" and for "mapper.x"."""
    return {f"{group}.{path.split('.')[-1]}": path for path in paths}


_EXTRACTION = _named(
    "SiftExtraction", "use_gpu", "num_threads", "max_image_size", "sift.max_num_features", "sift.first_octave"
)
_READER = _named("ImageReader", "camera_model", "camera_params", "existing_camera_id")
_MATCHING = _named("SiftMatching", "use_gpu", "num_threads", "guided_matching")
_GEOMETRY = _named("SiftMatching", "min_num_inliers")
_MAPPER = _named(
    "Mapper", "num_threads", "min_num_matches", "min_model_size", "ba_refine_focal_length", "ba_refine_extra_params",
    "mapper.init_min_tri_angle", "mapper.abs_pose_min_num_inliers",
)  # fmt: skip
_ADJUSTMENT = _named("BundleAdjustment", "refine_focal_length", "refine_principal_point", "refine_extra_params")
_POISSON = _named("PoissonMeshing", "point_weight", "depth", "trim", "num_threads")


class UsageError(Exception):
    """The command line is wrong."""


class Arguments:
    """The options of a command; an option that the command does not use is an error."""

    def __init__(self, words: list[str]) -> None:
        if len(words) % 2 or any(not word.startswith("--") for word in words[::2]):
            raise UsageError(f"expected `--option value` again and again, got {' '.join(words)}")
        self._values = {key[2:]: value for key, value in zip(words[::2], words[1::2], strict=True)}

    def take(self, name: str, default: str | None = None) -> str:
        """The text of an option; UsageError if the option is missing and has no default."""
        value = self._values.pop(name, default)
        if value is None:
            raise UsageError(f"--{name} is missing")
        return value

    def fill(self, target: Any, names: Mapping[str, str]) -> Any:
        """Set attributes of pycolmap's `target`. names: attribute paths by the names of the options."""
        for name, path in names.items():
            if name in self._values:
                *owners, attribute = path.split(".")
                owner = target
                for part in owners:
                    owner = getattr(owner, part)
                kind = type(getattr(owner, attribute))
                text = self._values.pop(name)
                setattr(owner, attribute, bool(int(text)) if kind is bool else kind(text))
        return target

    def finish(self) -> None:
        """Raise UsageError for options that were not used."""
        if self._values:
            raise UsageError(f"there is no --{next(iter(self._values))} here")


def extract_features(colmap: Any, arguments: Arguments) -> None:
    """`feature_extractor`: SIFT features of listed images into a database."""
    reader = arguments.fill(colmap.ImageReaderOptions(), _READER)
    extraction = arguments.fill(colmap.FeatureExtractionOptions(), _EXTRACTION)
    extraction.type = colmap.FeatureExtractorType.SIFT
    database, images = arguments.take("database_path"), arguments.take("image_path")
    names = [line for line in Path(arguments.take("image_list_path")).read_text(encoding="utf-8").splitlines() if line]
    single = bool(int(arguments.take("ImageReader.single_camera", "0")))
    arguments.finish()
    mode = colmap.CameraMode.SINGLE if single else colmap.CameraMode.AUTO
    colmap.extract_features(database, images, names, mode, reader, extraction, colmap.Device.cpu)


def import_matches(colmap: Any, arguments: Arguments) -> None:
    """`matches_importer`: verification of the pairs in a list; pairs with matches in the database are not matched again."""
    matching = arguments.fill(colmap.FeatureMatchingOptions(), _MATCHING)
    geometry = arguments.fill(colmap.TwoViewGeometryOptions(), _GEOMETRY)
    pairing = colmap.ImportedPairingOptions()
    pairing.match_list_path = arguments.take("match_list_path")
    database = arguments.take("database_path")
    arguments.finish()
    with colmap.Database.open(database) as connection:
        calibrated = all(camera.has_prior_focal_length for camera in connection.read_all_cameras())
    if not calibrated:
        # If a homography explains most matches, 4.x keeps only its inliers, but 3.8 those of the fundamental matrix. An
        # object on a textured board must not lose its points.
        geometry.max_H_inlier_ratio = 1.0
        geometry.use_degensac = True
    colmap.match_image_pairs(database, matching, pairing, geometry, colmap.Device.cpu)


def default_threads() -> int:
    """Number of threads if no option gives it; -1 = all processors."""
    return int(os.environ.get("OMP_NUM_THREADS", "-1"))


def pipeline_options(colmap: Any, arguments: Arguments) -> Any:
    """The options `Mapper.*`, which several commands share."""
    options = colmap.IncrementalPipelineOptions()
    options.num_threads = default_threads()
    return arguments.fill(options, _MAPPER)


def map_images(colmap: Any, arguments: Arguments) -> None:
    """`mapper`: models from a database, one folder each."""
    options = pipeline_options(colmap, arguments)
    paths = [arguments.take(name) for name in ("database_path", "image_path", "output_path")]
    arguments.finish()
    colmap.incremental_mapping(*paths, options)


def register_images(colmap: Any, arguments: Arguments) -> None:
    """`image_registrator`: poses of the database's images that a model lacks; the poses of all other images are unchanged."""
    options = pipeline_options(colmap, arguments)
    database, source, target = (arguments.take(name) for name in ("database_path", "input_path", "output_path"))
    arguments.finish()
    settings = colmap.DatabaseCacheOptions()
    settings.min_num_matches = options.min_num_matches
    with colmap.Database.open(database) as connection:
        cache = colmap.DatabaseCache.create(connection, settings)
    model = colmap.Reconstruction(source)
    mapper = colmap.IncrementalMapper(cache)
    mapper.begin_reconstruction(model)
    missing = [number for number, image in model.images.items() if not image.has_pose]
    for number in missing:
        placed = mapper.register_next_image(options.get_mapper(), number)
        print(f"image #{number}: {'registered' if placed else 'not registered'}", flush=True)
    mapper.end_reconstruction(False)
    model.write(target)


def triangulate_points(colmap: Any, arguments: Arguments) -> None:
    """`point_triangulator`: points of a model whose cameras are held fixed."""
    options = pipeline_options(colmap, arguments)
    source = arguments.take("input_path")
    paths = [arguments.take(name) for name in ("database_path", "image_path", "output_path")]
    clear = bool(int(arguments.take("clear_points", "0")))
    arguments.finish()
    colmap.triangulate_points(colmap.Reconstruction(source), *paths, clear, options, False)


def filter_points(colmap: Any, arguments: Arguments) -> None:
    """`point_filtering`: a model without points of large residual, small angle or few images."""
    source, target = arguments.take("input_path"), arguments.take("output_path")
    error, angle = (float(arguments.take(name)) for name in ("max_reproj_error", "min_tri_angle"))
    length = int(arguments.take("min_track_len"))
    arguments.finish()
    model = colmap.Reconstruction(source)
    observations = colmap.ObservationManager(model)
    count = observations.filter_all_points3D(error, angle)
    count += observations.filter_points3D_with_short_tracks(length)
    print(f"{count} observations left out", flush=True)
    model.write(target)


def adjust_bundle(colmap: Any, arguments: Arguments) -> None:
    """`bundle_adjuster`: cameras and points of a model."""
    options = arguments.fill(colmap.BundleAdjustmentOptions(), _ADJUSTMENT)
    options.ceres.solver_options.num_threads = default_threads()
    source, target = arguments.take("input_path"), arguments.take("output_path")
    arguments.finish()
    model = colmap.Reconstruction(source)
    colmap.bundle_adjustment(model, options)
    model.write(target)


def mesh_by_poisson(colmap: Any, arguments: Arguments) -> None:
    """`poisson_mesher`: triangle mesh of a cloud with normals (PLY)."""
    options = arguments.fill(colmap.PoissonMeshingOptions(), _POISSON)
    paths = [arguments.take(name) for name in ("input_path", "output_path")]
    arguments.finish()
    colmap.poisson_meshing(*paths, options)


def say_version(colmap: Any, arguments: Arguments) -> None:
    """`help`: the version of COLMAP."""
    arguments.finish()
    print(f"COLMAP {colmap.__version__} -- pycolmap")


COMMANDS: dict[str, Callable[[Any, Arguments], None]] = {
    "help": say_version,
    "feature_extractor": extract_features,
    "matches_importer": import_matches,
    "mapper": map_images,
    "image_registrator": register_images,
    "point_triangulator": triangulate_points,
    "point_filtering": filter_points,
    "bundle_adjuster": adjust_bundle,
    "poisson_mesher": mesh_by_poisson,
}


def main(words: list[str]) -> int:
    """Run a command; 0, or 1 with the reason as the last line of stderr."""
    try:
        if not words or words[0] not in COMMANDS:
            raise UsageError(f"expected a command: {', '.join(COMMANDS)}")
        arguments = Arguments(words[1:])
        colmap = importlib.import_module("pycolmap")
        colmap.logging.logtostderr = True
        colmap.set_random_seed(0)
        COMMANDS[words[0]](colmap, arguments)
    except Exception as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
