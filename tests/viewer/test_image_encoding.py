"""Images go to the browser quickly and as they are."""

import io

import numpy as np
import pytest
from PIL import Image
from viser import _scene_api

from fdcal.viewer.server.hardening import encoded


@pytest.mark.parametrize("channels", [3, 4])
def test_a_png_image_comes_back_as_it_was(channels):
    image = np.random.default_rng(0).integers(0, 256, (7, 11, channels), dtype=np.uint8)
    for ordering, shown in (("rgb", image), ("bgr", image[:, :, [2, 1, 0, 3][:channels]])):
        np.testing.assert_array_equal(Image.open(io.BytesIO(encoded("png", image, None, ordering))), shown)


def test_a_jpeg_image_has_the_quality_asked_for():
    y, x = np.mgrid[:80, :90]
    image = np.stack([2 * x, 3 * y, x + y], axis=-1).astype(np.uint8)
    fine, coarse = (encoded("jpeg", image, quality, "rgb") for quality in (92, 20))
    assert Image.open(io.BytesIO(fine)).format == "JPEG" and len(coarse) < len(fine)
    assert np.abs(np.asarray(Image.open(io.BytesIO(fine)), int) - image).mean() < 3


def test_the_server_encodes_by_it(server):
    assert _scene_api.cv2_imencode_with_fallback is encoded
    handle = server.scene.add_image("/test_encoding", np.zeros((4, 4, 3), np.uint8), 1.0, 1.0, format="png")
    assert Image.open(io.BytesIO(handle._data)).size == (4, 4)
    handle.remove()
