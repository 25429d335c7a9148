"""Quick encoding of the images of the page.

Without OpenCV viser compresses PNG images as far as it can, by imageio: four times the time of the first level, for a
sixth less data, which goes to a browser on the same machine. The name that is replaced is a private part of viser,
whose version is pinned.
"""

from __future__ import annotations

import io
from typing import Literal

import numpy as np
from PIL import Image
from viser import _scene_api

LEVEL = 1  # of compression, 0 to 9
QUALITY = 75  # of a JPEG image unless given


def encoded(
    format: Literal["png", "jpeg"], image: np.ndarray, jpeg_quality: int | None, channel_ordering: Literal["rgb", "bgr"]
) -> bytes:
    """Return an image as a file; the parameters are those of the function of viser that this replaces.

    `format`: "png" or "jpeg"; `image` (h, w, 3) or (h, w, 4) uint8; `jpeg_quality`: 1 to 95; None for QUALITY;
    `channel_ordering`: of `image`.
    """
    if channel_ordering == "bgr":
        image = image[:, :, [2, 1, 0, 3][: image.shape[2]]]
    file = io.BytesIO()
    picture = Image.fromarray(np.ascontiguousarray(image))
    if format == "png":
        picture.save(file, "PNG", compress_level=LEVEL)
    else:
        picture.save(file, "JPEG", quality=jpeg_quality or QUALITY)
    return file.getvalue()


def use_quick_encoding() -> None:
    """Have viser encode images by this module from now on.

    Raises AttributeError: viser no longer has the name under which it takes the function.
    """
    if not hasattr(_scene_api, "cv2_imencode_with_fallback"):
        raise AttributeError("viser has no cv2_imencode_with_fallback")
    setattr(_scene_api, "cv2_imencode_with_fallback", encoded)  # noqa: B010  the name is private to viser's module
