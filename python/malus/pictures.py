"""Pictures as image files, and as addresses in web pages."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from malus.errors import ResourceError


def encode(picture: NDArray[np.uint8], kind: str, **options: Any) -> bytes:
    """Image file of a picture H×W, H×W×2 (gray, alpha), H×W×3 or H×W×4.

    ResourceError if Pillow cannot write this kind: with too little memory to load a format's library, Pillow silently leaves the
    format out.
    """
    if kind not in Image.SAVE:
        Image.init()
    if kind not in Image.SAVE:
        raise ResourceError(
            f"Pillow cannot write {kind}: too little memory to load its library, or a Pillow that was built without it"
        )
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture)).save(buffer, kind, **options)
    return buffer.getvalue()


def data_url(picture: NDArray[np.uint8], kind: str, **options: Any) -> str:
    """Address for a web page that contains the picture itself; as `encode`."""
    return f"data:image/{kind.lower()};base64,{base64.b64encode(encode(picture, kind, **options)).decode()}"
