"""Which requests Studio answers, and which files it may read and write.

Any web page that is open in the same browser can send requests to 127.0.0.1. Every request therefore needs the right Host and the
cookie, which is set only by the entrance address with its random token. A request that changes anything also needs the page's own
Origin and a second token that only the page knows.
"""

from __future__ import annotations

import secrets
from pathlib import Path

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from malus._files import require_utf8, resolved
from malus.errors import InputError

_POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; object-src 'none'; "
    "base-uri 'none'; form-action 'self'; frame-ancestors 'self'"
)
#: A report may come from an unknown source. Its scripts run, but as a page without origin: they cannot send requests to Studio, nor
#: load anything from other hosts, which would reveal the report to them.
_REPORT_POLICY = (
    "sandbox allow-scripts allow-popups allow-downloads; default-src 'none'; img-src {hosts} data: blob:; "
    "style-src 'unsafe-inline'; script-src 'unsafe-inline' blob:; worker-src blob:; frame-ancestors 'self'"
)
#: Addresses that carry their own random key.
REPORTS = "/report/"


class Access:
    """The tokens and addresses of one running Studio."""

    def __init__(self, port: int) -> None:
        self._token = secrets.token_urlsafe(32)
        self._cookie = f"malus_studio_{port}"
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        self.report_policy = _REPORT_POLICY.format(hosts=" ".join(sorted(self._hosts)))
        self.page_token = secrets.token_urlsafe(32)
        self.entrance = f"http://127.0.0.1:{port}/?token={self._token}"

    def refusal(self, scope: Scope) -> Response | None:
        """The answer to a request that is refused or redirected; None if the request is to be served."""
        request = Request(scope)
        if request.headers.get("host") not in self._hosts:
            return PlainTextResponse("Studio answers only to 127.0.0.1 and localhost.", 421)
        if scope["path"].startswith(REPORTS):
            return None
        given = request.query_params.get("token", "")
        if scope["path"] == "/" and given and secrets.compare_digest(given.encode(), self._token.encode()):
            response = RedirectResponse("/", 303)
            response.set_cookie(self._cookie, self._token, httponly=True, samesite="strict")
            return response
        cookie = request.cookies.get(self._cookie, "")
        if not secrets.compare_digest(cookie.encode(), self._token.encode()):
            return PlainTextResponse("Open the address that `malus studio` has printed; it carries the key.", 403)
        if scope["method"] not in ("GET", "HEAD"):
            return self._refusal_to_change(request.headers)
        return None

    def _refusal_to_change(self, headers: Headers) -> Response | None:
        if headers.get("origin", "") not in {f"http://{host}" for host in self._hosts}:
            return PlainTextResponse("This request comes from another page than Studio's.", 403)
        if not secrets.compare_digest(headers.get("x-malus-page", "").encode(), self.page_token.encode()):
            return PlainTextResponse("The page is of an earlier Studio; reload it.", 403)
        return None


class Guard:
    """ASGI middleware: passes on only requests that `Access` allows, and sets what pages may load."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                report = scope["path"].startswith(REPORTS)
                headers["Content-Security-Policy"] = self._access.report_policy if report else _POLICY
                if not report:  # Pages of other ports have the cookie, too, but must not embed the answer.
                    headers["Cross-Origin-Resource-Policy"] = "same-origin"
                headers["X-Content-Type-Options"] = "nosniff"
                headers["Referrer-Policy"] = "no-referrer"
                headers["Cache-Control"] = "no-store"
            await send(message)

        refused = self._access.refusal(scope)
        await (refused or self._app)(scope, receive, send_guarded)


class Root:
    """The opened folder; every path that the page names is relative to it."""

    def __init__(self, folder: Path) -> None:
        self.folder = resolved(folder)

    def path(self, name: str) -> Path:
        """The path of a name from the page; InputError if the path, after following links, is outside the folder."""
        path = resolved(self.folder / name)
        if not self.holds(path):
            raise InputError(f"{name}: lies outside the folder that Studio has opened, {self.folder}")
        return path

    def holds(self, path: Path) -> bool:
        """Whether a path, after following links, is in the folder, and is valid UTF-8; False for circular links."""
        try:
            require_utf8(path)
            return resolved(path).is_relative_to(self.folder)
        except InputError:
            return False

    def file(self, name: str) -> Path:
        """The path of an existing file; InputError if there is none."""
        path = self.path(name)
        if not path.is_file():
            raise InputError(f"{name}: no such file in {self.folder}")
        return path

    def directory(self, name: str) -> Path:
        """The path of an existing folder; InputError if there is none."""
        path = self.path(name)
        if not path.is_dir():
            raise InputError(f"{name}: no such folder in {self.folder}")
        return path

    def name(self, path: Path) -> str:
        """The name of a path on the page; InputError for a path outside the folder."""
        return self.path(str(path)).relative_to(self.folder).as_posix()
