"""Malus Studio: a local web application for the whole way from a folder of images to the report (extra `studio`)."""

from __future__ import annotations

import socket
import webbrowser
from pathlib import Path

from malus._extra import extra
from malus.errors import InputError, ResourceError

#: The only address that Studio listens on.
ADDRESS = "127.0.0.1"


def serve(folder: str | Path = ".", *, port: int = 0, browser: bool = True) -> None:
    """Serve Studio for a folder until Ctrl-C, which also ends the runs that Studio started; their finished steps are kept.

    Only files below `folder` can be seen or written. port 0 = any free port. `browser`: open the page in the web browser.
    Raises malus.InputError if there is no such folder or port, malus.ExternalError unless the extra `studio` is installed,
    malus.ResourceError if the port is taken.
    """
    root = Path(folder)
    if root.is_file():
        raise InputError(f"{folder}: is a file, expected its folder: {root.parent}")
    if not root.is_dir():
        raise InputError(f"{folder}: no such folder, expected one with images or stations")
    if not 0 <= port <= 65535:
        raise InputError(f"--port {port}, expected 0 to 65535; 0 = any free port")
    purpose = "malus studio"
    for package in ("starlette", "tomlkit"):
        extra(package, package, purpose, "studio")
    uvicorn = extra("uvicorn", "uvicorn", purpose, "studio")
    from malus.studio.app import Studio

    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((ADDRESS, port))
        listener.listen()  # The printed address must work at once.
    except OSError as error:
        raise ResourceError(
            f"--port {port}: cannot be used ({error.strerror or error}), expected a free port"
        ) from None
    studio = Studio(root, listener.getsockname()[1])
    print(f"Malus Studio for {root.resolve()}\n  {studio.access.entrance}\nCtrl-C ends it.", flush=True)
    if browser:
        webbrowser.open(studio.access.entrance)
    server = uvicorn.Server(uvicorn.Config(studio.app, log_level="warning", timeout_graceful_shutdown=2))
    try:
        server.run(sockets=[listener])
    except KeyboardInterrupt:
        pass
    finally:
        studio.runs.close()
