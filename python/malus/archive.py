"""A finished workspace as a package for archives: RO-Crate 1.1 (Process Run Crate) in a BagIt 1.0 bag, one ZIP file.

It contains all inputs and all outputs: station file, images, prior, every result and the report. It also contains the paradata that
the London Charter asks for: which step made which file from which inputs, when, in how long, with which settings and versions.
The catalog entries come from [object] in the station file, the data of the capture from the images' EXIF.
"""

from __future__ import annotations

import json
import mimetypes
import os
import shutil
import zipfile
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote
from xml.sax.saxutils import escape

from PIL.ExifTags import Base

from malus import _core, exif
from malus._extra import extra
from malus._files import replacing, scratch_folder, sha256_of
from malus.errors import InputError
from malus.lengths import shown
from malus.workspace import Workspace

#: [object] key → term of schema.org that RO-Crate uses, and element of Dublin Core.
TERMS: dict[str, tuple[str, str]] = {
    "identifier": ("identifier", "identifier"),
    "title": ("name", "title"),
    "maker": ("creator", "creator"),
    "date": ("dateCreated", "date"),
    "place": ("locationCreated", "coverage"),
    "material": ("material", "format"),
    "description": ("description", "description"),
    "collection": ("isPartOf", "relation"),
    "recorded_by": ("author", "contributor"),
    "rights": ("copyrightNotice", "rights"),
    "license": ("license", "rights"),
}
_PROFILE = "https://w3id.org/ro/wfrun/process/0.5"
#: EXIF tag → name, of the tags that matter for a record of the capture.
_CAPTURE = {
    Base.Make: "camera maker",
    Base.Model: "camera",
    Base.DateTimeOriginal: "taken at",
    Base.ExposureTime: "exposure time (s)",
    Base.FNumber: "aperture (f/)",
    Base.ISOSpeedRatings: "ISO sensitivity",
    Base.FocalLength: "focal length (mm)",
    Base.LensModel: "lens",
}


@dataclass(frozen=True)
class _Input:
    path: Path
    sha256: str
    """Checksum of the content that the run read."""


def _inputs(workspace: Workspace) -> dict[str, _Input | None]:
    """All inputs of the surface: name relative to the station file (or, for a station made in code, the whole path) → file; None
    for an array.

    InputError if an input is missing or differs from what the run read.
    """
    station = workspace.manifest["station"]
    if not station.get("file"):
        given = workspace.manifest["inputs"].items()
        return {name: _as_read(Path(name), sha256) if Path(name).is_absolute() else None for name, sha256 in given}
    here = workspace.folder / station.get("file_from_here", "")
    file = here if here.is_file() else Path(station["file"])
    files: dict[str, _Input | None] = {}
    for name, sha256 in {**workspace.manifest["inputs"], file.name: station["says"]["sha256"]}.items():
        path = Path(os.path.normpath(file.parent / name))  # ".." in a recorded name does not follow links
        if not path.suffix and not path.is_file():  # an array ("prior points"): given, or read by Python
            files[name] = None
            continue
        files[name] = _as_read(path, sha256)
    return files


def _as_read(path: Path, sha256: str) -> _Input:
    _require_there(path)
    if sha256_of(path) != sha256:
        raise _changed(path)
    return _Input(path, sha256)


def _require_there(path: Path) -> None:
    if not path.is_file():
        raise InputError(f"{path}: is not there any more, expected every file that the surface was made from")


def _changed(path: Path) -> InputError:
    return InputError(f"{path}: was changed since the surface was made from it; run `malus run` again")


def _place(name: str, sha256: str) -> str:
    """Where an input lies in the crate; files from outside the station's folder get a folder of their own."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        return f"inputs/elsewhere/{sha256[:8]}/{path.name}"
    return f"inputs/{path}"


def _capture_of(path: Path) -> dict[str, str]:
    """The EXIF data of a photograph about its capture, by their names."""
    tags = exif.tags_of(path)
    return {name: str(tags[tag]).strip("\0 ") for tag, name in _CAPTURE.items() if tag in tags}


class _Crate:
    """The RO-Crate: its description and its files."""

    def __init__(self, workspace: Workspace) -> None:
        rocrate, entities = (
            extra(module, "rocrate", "an archive (--format archive)", "archive")
            for module in ("rocrate.rocrate", "rocrate.model.contextentity")
        )
        self.workspace = workspace
        self.quality = workspace.quality
        self.object = {key: value for key, value in self.quality.get("object", {}).items() if value}
        self.crate: Any = rocrate.ROCrate(version="1.1")
        self._entity = entities.ContextEntity
        self.placed: dict[str, Any] = {}
        #: crate path → source.
        self.sources: dict[str, Path] = {}

    def entity(self, place: str, kind: str, properties: dict[str, Any]) -> Any:
        # An @id is an address, in which blanks and letters of other scripts are escaped; rocrate does so for files only.
        address = quote(place, safe="/:#")
        return self.crate.add(self._entity(self.crate, address, properties={"@type": kind, **properties}))

    def file(self, place: str, source: Path, sha256: str | None, **properties: Any) -> Any:
        kind = mimetypes.guess_type(place)[0] or "application/octet-stream"
        known = {"name": place, "encodingFormat": kind, "contentSize": str(source.stat().st_size), **properties}
        if sha256:
            known["sha256"] = sha256
        entity = self.crate.add_file(source, place, properties=known)
        self.placed[place] = entity
        self.sources[place] = source
        return entity

    def require_packed(self, packed: dict[str, dict[str, str]]) -> None:
        """InputError if a packed file does not have the checksum that the description states; `packed`: the bag's checksums."""
        for place, entity in self.placed.items():
            if (stated := entity.get("sha256")) and packed[f"data/{place}"]["sha256"] != stated:
                raise InputError(f"{self.sources[place]}: was changed while it was packed; run `malus export` again")

    def values(self, owner: str, facts: dict[str, str]) -> list[Any]:
        return [
            self.entity(f"#{owner}-{k}", "PropertyValue", {"name": name, "value": value})
            for k, (name, value) in enumerate(facts.items())
        ]


def _flat(entities: list[Any]) -> Any:
    """A single entity instead of a list of one, as RO-Crate's JSON-LD requires."""
    return entities[0] if len(entities) == 1 else entities


def _describe_root(crate: _Crate, made: datetime) -> None:
    quality, known = crate.quality, crate.object
    title = known.get("title", quality["name"])
    confidence = quality["confidence"]
    crate.crate.name = f"{title}: surface from polarization and stereo"
    crate.crate.description = known.get(
        "description",
        f"Surface of {title}, ground sampling distance {shown(quality['gsd'], quality['unit'], 4)}, "
        f"confidence {confidence['level']}; with everything that it was made from.",
    )
    root = crate.crate.root_dataset
    root["datePublished"] = made.date().isoformat()
    # RO-Crate requires a license; without one, state that none was given.
    root["license"] = known.get("license", "No license was stated in [object] of the station file.")
    profile = crate.entity(_PROFILE, "CreativeWork", {"name": "Process Run Crate", "version": "0.5"})
    root["conformsTo"] = profile
    subject = {TERMS[key][0]: value for key, value in known.items() if key in TERMS and key != "recorded_by"}
    root["about"] = crate.entity("#object", "CreativeWork", {"name": title, **subject})
    if "recorded_by" in known:
        root["author"] = crate.entity("#recorded-by", "Person", {"name": known["recorded_by"]})
    if "recorded_on" in known:
        root["temporalCoverage"] = known["recorded_on"]


def _add_files(crate: _Crate, inputs: dict[str, _Input | None]) -> dict[str, Any]:
    """Add all inputs and results; returns the entities of the inputs by their names in the manifest."""
    workspace = crate.workspace
    entities: dict[str, Any] = {}
    for name, file in inputs.items():
        if file is None:
            entities[name] = crate.entity(
                f"#{name}", "Thing", {"name": name, "description": "an array given in memory"}
            )
            continue
        place = _place(name, file.sha256)
        facts = crate.values(place, _capture_of(file.path))
        entities[name] = crate.file(place, file.path, file.sha256, **({"exifData": _flat(facts)} if facts else {}))
    for name, output in workspace.outputs.items():
        crate.file(f"results/{name}", workspace.path(name), output["sha256"])
    crate.file("results/manifest.json", workspace.folder / "manifest.json", None, name="settings, versions and hashes")
    return entities


def _add_steps(crate: _Crate, inputs: dict[str, Any]) -> None:
    """Add one CreateAction per step: its inputs, outputs, time, settings and program."""
    manifest = crate.workspace.manifest
    tools = [
        crate.entity(f"#{name.replace(' ', '-')}", "SoftwareApplication", {"name": name, "softwareVersion": version})
        for name, version in manifest["versions"].items()
    ]
    tool = next(entity for entity in tools if entity["name"] == "malus")
    tool["softwareRequirements"] = [entity for entity in tools if entity is not tool]
    agent = crate.crate.root_dataset.get("author")
    purpose = {name: does for name, does, _, _ in _core.describe_run(json.dumps(manifest["options"]), "assess")}
    actions = []
    for name, step in manifest["steps"].items():
        times = manifest["times"].get(name, {})
        settings = {
            f"{section}.{key}": json.dumps(value)
            for section, values in step.get("options", {}).items()
            for key, value in (values.items() if isinstance(values, dict) else [("", values)])
        }
        made = [crate.placed[f"results/{output}"] for output in step["outputs"]]
        # The manifest does not list which results of earlier steps a step read: take all outputs of the steps on which it depends.
        taken = [inputs[file] for file in step["inputs"] if file in inputs]
        for before in step.get("after", {}):
            taken += [crate.placed[f"results/{file}"] for file in manifest["steps"][before]["outputs"]]
        action = {
            "name": f"{name}: {purpose.get(name, name)}",
            "description": f"Step '{name}' of the reconstruction: {purpose.get(name, name)}",
            "instrument": tool,
            "object": _flat(taken),
            "result": _flat(made),
            "additionalProperty": _flat(crate.values(f"setting-{name}", settings)),
            "actionStatus": "http://schema.org/CompletedActionStatus",
        }
        if "finished" in times:
            end = datetime.fromisoformat(times["finished"])
            start = end - timedelta(seconds=float(times.get("seconds", 0)))
            action["endTime"] = end.isoformat(timespec="milliseconds")
            action["startTime"] = start.isoformat(timespec="milliseconds")
        if agent is not None:
            action["agent"] = agent
        actions.append(crate.entity(f"#step-{name}", "CreateAction", action))
    crate.crate.root_dataset["mentions"] = actions


def dublin_core(title: str, known: dict[str, str]) -> str:
    """The entries of [object] as simple Dublin Core, an oai_dc record."""
    elements = [("title", known.get("title", title)), ("type", "Dataset")]
    elements += [(TERMS[key][1], value) for key, value in known.items() if key in TERMS and key != "title"]
    # This date is that of the data set, which the record describes; the object's own date precedes it.
    elements += [("date", known["recorded_on"])] if "recorded_on" in known else []
    body = "\n".join(f"  <dc:{name}>{escape(value)}</dc:{name}>" for name, value in elements)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<oai_dc:dc xmlns:oai_dc="http://www.openarchives.org/OAI/2.0/oai_dc/"\n'
        '           xmlns:dc="http://purl.org/dc/elements/1.1/">\n'
        f"{body}\n</oai_dc:dc>\n"
    )


def _zip(folder: Path, path: Path) -> None:
    """Write a ZIP file with the folder as its only top-level entry."""
    # Not strict: a camera whose clock was never set writes dates that ZIP cannot store.
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=3, strict_timestamps=False) as file:
        for source in sorted(folder.rglob("*")):
            if source.is_file():
                file.write(source, PurePosixPath(folder.name) / source.relative_to(folder).as_posix())


def write_archive(work: str | Path, path: str | Path) -> Path:
    """Write a workspace and all its inputs as a BagIt bag that is also an RO-Crate, one ZIP file; returns its path.

    Every file's SHA-256 is checked against the run's record first. InputError if an input was changed or is missing.
    """
    bagit = extra("bagit", "bagit", "an archive (--format archive)", "archive")
    workspace, path = Workspace(work), Path(path)
    made = datetime.now(UTC)
    crate = _Crate(workspace)
    _describe_root(crate, made)
    _add_steps(crate, _add_files(crate, _inputs(workspace)))
    name = str(workspace.quality["name"])
    path.parent.mkdir(parents=True, exist_ok=True)
    # The bag is made beside the archive, because that disk must have room for the archive anyway.
    with scratch_folder(path) as scratch:
        bag = scratch / "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
        bag.mkdir()
        record = bag / "metadata" / "dublin_core.xml"
        record.parent.mkdir()
        record.write_text(dublin_core(name, crate.object), encoding="utf-8")
        crate.file("metadata/dublin_core.xml", record, None, name="catalog record, Dublin Core")
        crate.crate.metadata.write(bag)
        for place, source in crate.sources.items():
            target = bag / place
            if target == source:
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                # Link the target of a symbolic link: the link itself may lead nowhere from the bag.
                os.link(os.path.realpath(source), target)
            except OSError:
                shutil.copyfile(source, target)
        known = crate.object
        facts = {
            "External-Description": crate.crate.description,
            "External-Identifier": known.get("identifier", name),
            "Contact-Name": known.get("recorded_by", ""),
            "Source-Organization": known.get("collection", ""),
            "Bagging-Date": made.date().isoformat(),
            "Bag-Software-Agent": f"malus {workspace.manifest['versions']['malus']}, bagit {bagit.VERSION}",
        }
        made_bag = bagit.make_bag(
            str(bag), {key: value for key, value in facts.items() if value}, checksums=["sha256", "sha512"]
        )
        crate.require_packed(made_bag.entries)
        with replacing(path) as temporary:
            _zip(bag, temporary)
    return path
