"""The web application: the handler of each address. The other modules of this package do the work."""

from __future__ import annotations

import asyncio
import datetime
import itertools
import json
import math
import os
import secrets
import threading
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

import malus
from malus import lengths
from malus._files import relative_path, sha256_of
from malus.errors import InputError, MalusError, ending_of
from malus.raw import image_size
from malus.studio import checks, folders, marks, masks, phases, pictures, preview, results, runs, settings
from malus.studio.access import REPORTS, Access, Guard, Root
from malus.studio.document import ChangedError, StationDocument
from malus.workspace import is_result

#: Most bytes in the body of a request: a mask of a hundred megapixels is far smaller.
_MAX_BODY = 64_000_000
_STATIC = Path(str(resources.files("malus").joinpath("studio", "static")))

#: Threads that compute. The interpreter waits for them before it ends, so that the C++ library is not stopped midway.
_WORKERS = ThreadPoolExecutor(thread_name_prefix="studio")

#: For each painted image: table and key of the station file that name it, and values of the key that are not file names.
_PAINTED = {"mask": ("polarized", "mask", ()), "labels": ("optics", "reflection", ("diffuse", "specular", "auto"))}

Json = Mapping[str, Any]


class Studio:
    """One opened folder, with its routes, access tokens and runs."""

    def __init__(self, folder: Path, port: int) -> None:
        self.root = Root(folder)
        self.access = Access(port)
        self.runs = runs.Runs()
        self._report_keys: dict[str, Path] = {}
        self._threads = os.cpu_count() or 1
        # If two pages change a file at once, the second one must get a ChangedError.
        self._editing = threading.Lock()
        self.app = Starlette(routes=self._routes(), middleware=[Middleware(Guard, access=self.access)])

    def _routes(self) -> list[Route | Mount]:
        asked: dict[str, Callable[[Json], Any]] = {
            "folder": lambda q: folders.listing(self.root, q.get("path", "")),
            "candidates": lambda _: folders.candidates(self.root),
            "model": lambda q: {"images": folders.images_of_model(self.root.directory(q["path"]))},
            "station": self._station,
            "check": lambda q: checks.check(self.root.file(q["path"]), self._threads),
            "size": lambda q: dict(zip(("width", "height"), image_size(self.root.file(q["path"])), strict=True)),
            "runs": lambda _: [self._described(run) for run in self.runs.all()],
            "log": lambda q: {"lines": next((r.log for r in self.runs.all() if r.number == int(q["number"])), [])},
            "results": self._results,
            "comparisons": self._comparisons,
            "difference": lambda q: results.difference(self.root.directory(q["a"]), self.root.directory(q["b"])),
            "photos": self._photos,
            "options": self._options,
            "thumbnail": lambda q: Response(pictures.thumbnail(self.root.file(q["path"])), media_type="image/jpeg"),
            "tile": lambda q: Response(pictures.tile(self.root.file(q["path"]), int(q["halvings"]), int(q["column"]), int(q["row"]), _lens(q)), media_type="image/jpeg"),
            "mask": lambda q: Response(masks.read(self.root.file(q["path"]), q.get("kind", "mask")), media_type="image/png"),
            "relief": lambda q: Response(results.relief(self.root.directory(q["path"])), media_type="image/png"),
            "overlay": self._overlay,
            "phases": lambda q: phases.compared(malus.Station.load(self.root.file(q["path"])), self._threads),
            "outline": self._outline,
        }  # fmt: skip
        told: dict[str, Callable[[Json], Any]] = {
            "angles": lambda body: folders.angles(self.root, body["folder"], body["source"], body["images"], float(body.get("first", 0)), float(body.get("step", 45))),
            "preview": self._preview,
            "marks": self._marks,
            "control": self._control,
            "create": self._create,
            "set": self._set,
            "text": self._set_text,
            "option": self._set_option,
            "similar": self._similar,
            "run": self._run,
            "compare": self._compare,
            "keep": self._keep,
            "cancel": lambda body: self.runs.cancel(int(body["number"])),
            "profile": lambda body: results.profile(self.root.directory(body["path"]), tuple(body["from"]), tuple(body["to"])),
        }  # fmt: skip
        return [
            Route("/", self._page),
            *(Route(f"/api/{name}", _asking(function)) for name, function in asked.items()),
            *(Route(f"/api/{name}", _telling(function), methods=["POST"]) for name, function in told.items()),
            Route("/api/mask", self._write_mask, methods=["PUT"]),
            Route("/api/cut", self._cut_out, methods=["POST"]),
            Route(REPORTS + "{key}/{path:path}", self._report),
            Mount("/static", StaticFiles(directory=_STATIC)),
        ]

    # ---- pages and files ----

    async def _page(self, _: Request) -> Response:
        page = (_STATIC / "studio.html").read_text(encoding="utf-8")
        return Response(
            page.replace("{{page_token}}", self.access.page_token).replace("{{version}}", malus.__version__),
            media_type="text/html",
        )

    async def _report(self, request: Request) -> Response:
        folder = self._report_keys.get(request.path_params["key"])
        if folder is None:
            return Response("This report was opened by an earlier Studio.", 404)
        try:
            path = self.root.file(f"{folder}/{request.path_params['path']}")
            if path.is_relative_to(self.root.path(str(folder))):
                return FileResponse(path)
        except (MalusError, OSError):
            pass
        return Response("There is no such file in the report.", 404)

    def _report_address(self, folder: Path) -> str:
        """Address of the report page in this folder, with a key that gives access to this folder only."""
        key = next((key for key, known in self._report_keys.items() if known == folder), None)
        if key is None:
            key = secrets.token_urlsafe(24)
            self._report_keys[key] = folder
        return f"{REPORTS}{key}/index.html"

    # ---- the station file ----

    def _station(self, query: Json) -> Json:
        return self._shown(StationDocument.read(self.root.file(query["path"])))

    def _shown(self, document: StationDocument) -> Json:
        """The file and its values; and, by their names on the page, its images, mask and labels that are in the opened folder. lens:
        as `pictures.Lens` if it has distortion, else None; of a station file without one, that which a run has calibrated. lens_known:
        whether that can be told.
        """
        images, error, camera = self._images(document)
        lens = pictures.distorting(camera)
        if camera is None and error is None and (model := self._model_of(document)) is not None:
            lens = marks.calibrated_lens(model)
        return {
            "path": self.root.name(document.path),
            "text": document.text,
            "digest": document.digest,
            "values": document.values,
            "images": images,
            "lens": lens,
            "lens_known": camera is not None or lens is not None,
            "painted": {kind: self._painted(document, kind) for kind in _PAINTED},
            "error": error,
        }

    def _images(self, document: StationDocument) -> tuple[list[str], str | None, Json | None]:
        """The polarized images by their names on the page, what is wrong with the station, and its camera if it is known."""
        try:
            description = malus.Station.load(document.path).describe()
            return [self.root.name(Path(path)) for path in description["images"]], None, description.get("camera")
        except MalusError as error:
            # The user may correct the error on these images, for example by marking control points.
            images = folders.polarized_images(self.root, document.path, document.values)
            return images, str(error), None

    def _painted(self, document: StationDocument, kind: str) -> Json | None:
        """The file that the station names for a mask or labels: its name on the page, and its digest. None if the station names
        no file, or a file outside the opened folder.
        """
        table, key, words = _PAINTED[kind]
        content = document.values.get(table)
        name = content.get(key) if isinstance(content, Mapping) else None
        path = document.path.parent / name if isinstance(name, str) and name not in words else None
        if path is None or not self.root.holds(path):
            return None
        return {"path": self.root.name(path), "digest": sha256_of(path) if path.is_file() else None}

    def _create(self, body: Json) -> Json:
        """A new station file from the page's table of images and angles."""
        path = self.root.path(body["path"])
        if path.suffix != ".toml":
            raise InputError(f"{body['path']}, expected a name that ends in .toml")
        document = StationDocument(path, "")
        document.set("station", "name", body.get("name") or path.parent.name)
        document.set("station", "unit", body.get("unit", "mm"))
        images = [self.root.file(name) for name in body["images"]]
        document.set("polarized", "images", [relative_path(image, path) for image in images])
        if body.get("mask") is not None:
            document.set("polarized", "mask", relative_path(self.root.file(body["mask"]), path))
        for key in ("angles_deg", "angle_direction", "angle_zero_deg", "response", "exposure_s"):
            if body.get(key) is not None:
                document.set("polarized", key, body[key])
        with self._editing:
            document.write(None)
        return self._shown(document)

    def _set(self, body: Json) -> Json:
        """Change values and lists of a station file. Paths come as the page names them and are written relative to the file."""
        with self._editing:
            document = StationDocument.read(self.root.file(body["path"]))
            document.require(body["digest"])
            for change in body["changes"]:
                if "entries" in change:
                    document.set_list(change["list"], change["entries"])
                    continue
                value = change["value"]
                if change.get("is_path") and value is not None:
                    value = relative_path(self.root.path(value), document.path)
                document.set(change["table"], change["key"], value)
            document.write(body["digest"])
            return self._shown(document)

    def _keep(self, body: Json) -> Json:
        """Add a profile that was picked on a result to the result's own station; in other stations its pixels are other places."""
        station, work = self.root.file(body["path"]), self.root.directory(body["work"])
        owner = results.station_of(self.root, work)
        if owner != self.root.name(station):
            whose = owner or "a station outside of this folder"
            raise InputError(f"{body['work']}: is a result of {whose}, expected one of {body['path']}; open the other station to keep the profile there")  # fmt: skip
        with self._editing:
            document = StationDocument.read(station)
            document.require(body["digest"])
            profiles = list(document.values.get("profile", []))
            taken = {
                profile.get("name") for profile in profiles
            }  # Names may not be given twice, also after one was removed.
            number = next(n for n in itertools.count(len(profiles) + 1) if f"picked {n}" not in taken)
            entry = {"name": f"picked {number}", "from": body["from"], "to": body["to"]}
            document.set_list("profile", [*profiles, entry])
            document.write(body["digest"])
            return self._shown(document)

    def _set_text(self, body: Json) -> Json:
        with self._editing:
            document = StationDocument(self.root.file(body["path"]), body["text"])
            document.write(body["digest"])
            return self._shown(document)

    def _options(self, query: Json) -> Json:
        station = self.root.file(query["path"])
        file = self.root.name(settings.file_of(station))  # Refuses a link that leads out of the folder.
        return {"file": file, "options": settings.listed(station)}

    def _set_option(self, body: Json) -> Json:
        with self._editing:
            before = self._options(body)
            settings.change(self.root.file(body["path"]), str(body["name"]), body["value"])
            return {**before, "options": settings.listed(self.root.file(body["path"]))}

    # ---- images, masks ----

    def _preview(self, body: Json) -> Json:
        return preview.preview(
            [self.root.file(name) for name in body["images"]],
            [float(angle) for angle in body["angles_deg"]],
            direction=body.get("angle_direction", "ccw"),
            zero_deg=float(body.get("angle_zero_deg", 0)),
            response=body.get("response", "linear"),
            exposure_s=body.get("exposure_s"),
        )

    def _photos(self, query: Json) -> list[dict[str, str]]:
        path = self.root.file(query["path"])
        return folders.photos_of(self.root, path, StationDocument.read(path).values)

    def _marks(self, body: Json) -> Json:
        document = StationDocument.read(self.root.file(body["path"]))
        model = self._model_of(document)
        bars = document.values.get("scale", [])
        options = settings.options_of(document.path)
        return marks.examined(model, bars, body["image"], int(body["distance"]), body["end"], options)

    def _control(self, body: Json) -> Json:
        document = StationDocument.read(self.root.file(body["path"]))
        options = settings.options_of(document.path)
        return marks.control(document.path, self._model_of(document), body["image"], body["name"], options)

    def _model_of(self, document: StationDocument) -> Path | None:
        """The model of the photos' cameras, if one is known."""
        works = [document.path.with_name(f"{document.path.stem}_work")]
        works += [run.work for run in self.runs.all() if run.station == document.path]
        return marks.model_of(document.path, document.values.get("camera", {}), works)

    def _similar(self, body: Json) -> Response:
        image = self.root.file(body["image"])
        found = masks.similar(image, int(body["u"]), int(body["v"]), int(body["tolerance"]))
        return Response(found, media_type="image/png")

    async def _cut_out(self, request: Request) -> Response:
        content = await _body(request)

        def cut() -> Response:
            image = self.root.file(request.query_params["image"])
            hints = masks.decode(content, image_size(image))
            return Response(masks.cut_out(image, hints, self._threads), media_type="image/png")

        return await _answer(cut)

    async def _write_mask(self, request: Request) -> Response:
        """Write a mask (or labels) beside the station file and name it there; never over an image that the page has not read."""
        content = await _body(request)
        query = request.query_params

        def write() -> Json:
            kind = "labels" if query.get("kind") == "labels" else "mask"
            table, key, words = _PAINTED[kind]
            with self._editing:
                document = StationDocument.read(self.root.file(query["path"]))
                document.require(query["digest"])
                present = self._painted(document, kind)
                if ((present or {}).get("digest") or "") != query.get("painted", ""):
                    raise ChangedError(self.root.path(present["path"]) if present else document.path)
                images, error, _ = self._images(document)
                if not images:
                    raise InputError(error or f"{document.path}: has no images")
                values = masks.decode(content, image_size(self.root.file(images[0])))
                named = document.values.get(table, {}).get(key, "")
                name = named if named and named not in words else f"{document.path.stem}_{kind}.png"
                target = self.root.path(str(document.path.parent / name))
                own = name == named and target.suffix == ".png"
                written = masks.write(target.with_suffix(".png"), values, may_replace=own)
                document.set(table, key, relative_path(written, document.path))
                document.write(query["digest"])
                return self._shown(document)

        return await _answer(write)

    def _outline(self, query: Json) -> Response:
        path = self.root.file(query["path"])
        found = masks.outline_of_prior(malus.Station.load(path), settings.options_of(path), self._threads)
        return Response(found, media_type="image/png")

    def _overlay(self, query: Json) -> Json:
        station = malus.Station.load(self.root.file(query["path"]))
        picture, cell, (near, far) = masks.overlay_of_prior(station, self._threads)
        near_far = {"near": lengths.shown(near, station.unit, 3), "far": lengths.shown(far, station.unit, 3)}
        return {"picture": picture, "cell": cell, **near_far}

    # ---- runs, results ----

    def _described(self, run: runs.Run) -> Json:
        return {
            **runs.described(run),
            "work": self.root.name(run.work),
            "report": self._report_address(run.page) if run.state == "done" else None,
        }

    def _run(self, body: Json) -> Json:
        station, work = self.root.file(body["path"]), self.root.path(body["work"])
        if work == self.root.folder or work == station.parent:
            raise InputError(f"{body['work']}: holds the inputs, expected a folder of its own for the results: {station.stem}_work")  # fmt: skip
        if work.is_dir() and any(work.iterdir()) and not is_result(work):
            raise InputError(f"{body['work']}: holds other files, expected a new folder or one with results of this station")  # fmt: skip
        fusion = body.get("fusion", "refined")
        if fusion not in ("grid", "refined"):
            raise InputError(f"fusion = {fusion!r}, expected grid or refined")
        title = f"{self.root.name(station)} → {self.root.name(work)}"
        return self._described(self.runs.add_station(station, work, fusion, title, {"name": "run", "body": body}))

    def _compare(self, body: Json) -> Json:
        before, after = (self.root.directory(body[key]) for key in ("before", "after"))
        folder = results.folder_of_comparison(self.root, before, after)
        title = f"{self.root.name(before)} and {self.root.name(after)} → {self.root.name(folder)}"
        asked = {"name": "compare", "body": body}
        return self._described(self.runs.add_comparison(before, after, folder, bool(body["same_frame"]), title, asked))

    def _comparisons(self, _: Json) -> list[dict[str, Any]]:
        return [
            {"path": name, "report": self._report_address(self.root.directory(name))}
            for name in results.comparisons(self.root)
        ]

    def _results(self, _: Json) -> list[dict[str, Any]]:
        found = []
        for name in results.works(self.root):
            folder = self.root.directory(name)
            said = results.summary(self.root, folder)
            address = self._report_address(folder / "report") if said.get("report") else None
            found.append({"path": name, **said, "report": address})
        return found


async def _body(request: Request) -> bytes:
    content = bytearray()
    async for chunk in request.stream():
        content += chunk
        if len(content) > _MAX_BODY:
            raise HTTPException(
                413, f"The request has more than {_MAX_BODY / 1e6:g} MB, which is more than Studio takes."
            )
    return bytes(content)


async def _answer(function: Callable[[], Any]) -> Response:
    """The result of a function, computed on another thread, or its error as JSON for the page."""
    try:
        result = await asyncio.get_running_loop().run_in_executor(_WORKERS, function)
        return result if isinstance(result, Response) else JSONResponse(_plain(result))
    except asyncio.CancelledError:  # Studio is closing and did not wait for the result.
        return Response("Malus Studio has been ended.", 503)
    except MalusError as error:
        status = 409 if isinstance(error, ChangedError) else 400
        return JSONResponse({"error": str(error)}, status)
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        return JSONResponse({"error": f"the request is not what Studio expects ({type(error).__name__}: {error})"}, 400)
    except OSError as error:
        return JSONResponse({"error": f"{error.filename or 'a file'}: {error.strerror or error}"}, 400)
    except Exception as error:  # The page shows unexpected errors, as the command line does.
        return JSONResponse({"error": ending_of(error)[1]}, 500)


def _lens(query: Json) -> pictures.Lens | None:
    """The lens whose distortion the page wants to be removed: JSON of the `lens` that it was told of the station; None without one."""
    if "lens" not in query:
        return None
    model, width, height, params = json.loads(query["lens"])
    return str(model), int(width), int(height), tuple(float(param) for param in params)


def _plain(value: Any) -> Any:
    """A value of a station file for JSON: dates and times as text, and None for nan and inf."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _asking(function: Callable[[Json], Any]) -> Callable[[Request], Awaitable[Response]]:
    async def endpoint(request: Request) -> Response:
        return await _answer(lambda: function(request.query_params))

    return endpoint


def _telling(function: Callable[[Json], Any]) -> Callable[[Request], Awaitable[Response]]:
    async def endpoint(request: Request) -> Response:
        content = await _body(request)

        def told() -> Any:
            body = json.loads(content)
            if not isinstance(body, dict):
                raise TypeError("no JSON object")
            return function(body)

        return await _answer(told)

    return endpoint
