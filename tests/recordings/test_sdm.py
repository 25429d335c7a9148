"""Files of a measured room: an impulse response with directions of arrival."""

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from fdcal.acoustics.plane_waves import load_sdm_response
from fdcal.model.validation import InputError

pytestmark = pytest.mark.usefixtures("apart")


@pytest.fixture
def response_file(tmp_path):
    path = tmp_path / "response.mat"
    rng = np.random.default_rng(0)
    angles = {"azi_rad": rng.uniform(-3, 3, 200), "ele_rad": rng.uniform(-1.5, 1.5, 200)}
    savemat(path, {"p": rng.normal(size=200) * np.exp(-np.arange(200) / 20), **angles, "fs": 48000.0})
    return path


@pytest.mark.parametrize("kind", (20, 255))
def test_an_element_of_an_unknown_type_is_refused(response_file, kind):
    """SciPy's compiled reader takes the type as an index and ends its process on some of these."""
    data = bytearray(response_file.read_bytes())
    tag = data.index(b"azi_rad") + 8  # of the values
    assert data[tag] == 9, "double"
    data[tag] = kind
    response_file.write_bytes(data)
    with pytest.raises(InputError, match=r"response\.mat"):
        load_sdm_response(response_file)


@pytest.mark.parametrize("length", (131, -1))
def test_a_file_that_is_cut_off_is_refused(response_file, length):
    response_file.write_bytes(response_file.read_bytes()[:length])
    with pytest.raises(InputError):
        load_sdm_response(response_file)


def test_variables_of_any_kind_may_stand_beside_a_response(response_file):
    table = {key: value for key, value in loadmat(response_file).items() if key[0] != "_"}
    expected = load_sdm_response(response_file).amplitudes
    others = {"text": "a room", "list": np.array([1, "b"], dtype=object), "parts": {"a": 1.0}, "z": np.array([1j])}
    savemat(response_file, {**others, **table}, do_compression=True, oned_as="column")
    assert np.array_equal(load_sdm_response(response_file).amplitudes, expected)
    savemat(response_file, table | {"p": np.full(200, 1.0 + 1j)})
    with pytest.raises(InputError, match="p is complex"):
        load_sdm_response(response_file)
