"""Colours that colour-blind eyes tell apart: distances in CIELAB after the simulation of Vienot, Brettel and Mollon."""

import itertools

import matplotlib
import numpy as np
import pytest

from fdcal.graphics import basin_map, legend, markers
from fdcal.graphics.primitives import COLOUR_MAP, DARK, DIVERGING_COLOUR_MAP, LIGHT
from fdcal.viewer.gui import plots
from fdcal.viewer.tabs import modes as spectrum_plot

# Of linear RGB: Vienot, Brettel and Mollon, Color Res. Appl. 24 (1999), 243. Rows sum to one: white stays white.
EYES = {
    "all cones": np.eye(3),
    "no long ones": np.array([[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]]),
    "no middle ones": np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]]),
}
APART = 15  # in CIELAB; two is just seen side by side


def lab(colours, eye):
    """CIELAB (D65) of sRGB colours (P, 3), 0 to 255, as an eye sees them."""
    rgb = np.asarray(colours, float).reshape(-1, 3) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ EYES[eye].T
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = np.clip(linear, 0, 1) @ to_xyz.T / to_xyz.sum(axis=1)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def rgb(text):
    return tuple(round(255 * share) for share in matplotlib.colors.to_rgb(text))


MARKS = {
    "true": markers.TRUE,
    "estimate": markers.ESTIMATE,
    "known": markers.KNOWN,
    "lowest": markers.LOWEST,
    "halo": markers.HALO,
}
TRACES = {"trail": markers.TRAIL, "ellipse": markers.ELLIPSE, "estimate": markers.ESTIMATE, "known": markers.KNOWN}
TRACES["cut"] = markers.CUT
BASINS = {f"basin {i}": tuple(colour) for i, colour in enumerate(basin_map.TABLE.tolist())}
CURVES = {"mean": rgb(plots.RED), "largest": rgb(plots.ORANGE), "cost": rgb(plots.BLUE)}
MODES = {"in": rgb(plots.BLUE), "out": rgb(plots.ORANGE), "spectrum": rgb(spectrum_plot.GREY)}


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize(
    "palette", [MARKS, TRACES, CURVES, MODES, BASINS], ids=["marks", "traces", "curves", "modes", "basins"]
)
def test_colours_of_one_picture_are_distinguishable(palette, eye):
    places = dict(zip(palette, lab(list(palette.values()), eye), strict=True))
    for one, other in itertools.combinations(palette, 2):
        assert np.linalg.norm(places[one] - places[other]) > APART, (one, other)


def test_the_simulation_is_what_it_should_be():
    np.testing.assert_allclose(lab([[255, 255, 255]], "no long ones"), [[100, 0, 0]], atol=0.1)
    red, green = lab([[200, 0, 0], [0, 118, 0]], "no middle ones")
    far = np.linalg.norm(np.subtract(*lab([[200, 0, 0], [0, 118, 0]], "all cones")))
    assert np.linalg.norm(red - green) < far / 3, "red and green of like lightness fall together"


@pytest.mark.parametrize("eye", EYES)
def test_a_map_grows_lighter_with_the_cost_for_every_eye(eye):
    colours = 255 * matplotlib.colormaps[COLOUR_MAP](np.linspace(0, 1, 64))[:, :3]
    assert (np.diff(lab(colours, eye)[:, 0]) > 0).all()
    low, middle, high = lab(255 * matplotlib.colormaps[DIVERGING_COLOUR_MAP]([0.0, 0.5, 1.0])[:, :3], eye)
    assert min(np.linalg.norm(low - high), np.linalg.norm(low - middle), np.linalg.norm(high - middle)) > APART


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_texts_stand_out_from_their_ground(theme):
    """Contrast of at least 7, the strictest of the Web Content Accessibility Guidelines."""

    def luminance(colour):
        share = np.asarray(colour, float) / 255
        linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722]

    dark, light = sorted([luminance(theme.background), luminance(theme.foreground)])
    assert (light + 0.05) / (dark + 0.05) > 7


def test_every_mark_has_a_shape_of_its_own():
    shapes = [(entry.paths, entry.filled) for entry in legend.MARKS.values() if entry.halo]
    assert len(shapes) == len(set(shapes)) == 7
