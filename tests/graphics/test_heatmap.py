"""A map on the floor and its colour bar show the given values at the right places.

Colour-blind readers can distinguish the colours: distances in CIELAB, simulated after Vienot, Brettel and Mollon.
"""

import itertools

import matplotlib
import numpy as np
import pytest

from fdcal.graphics import marks, primitives
from fdcal.graphics.heatmap import RELIEF_HEIGHT, cost_floor
from fdcal.graphics.picture import FAINTER, with_floor
from fdcal.model.settings import Search
from fdcal.viewer import html
from fdcal.viewer.tabs import curves as plots


def test_the_map_fills_the_search_domain_and_its_row_0_is_low_y():
    search = Search(origin=(1.0, 2.0), size=(0.4, 0.2), step=0.1)
    cost = np.arange(15.0).reshape(3, 5)
    floor = cost_floor(cost, search)
    np.testing.assert_allclose(floor.origin, (0.95, 1.95))
    np.testing.assert_allclose(floor.size, (0.5, 0.3))
    ends = matplotlib.colormaps[primitives.COLOUR_MAP]([0.0, 1.0], bytes=True)[:, :3]
    np.testing.assert_array_equal(floor.rgb[0, 0], ends[0])
    np.testing.assert_array_equal(floor.rgb[-1, -1], ends[1])
    assert (floor.bar.low, floor.bar.high) == pytest.approx(np.percentile(cost, [2, 98]).tolist())
    assert "dimensionless" in floor.bar.label


def test_a_diamond_stands_where_the_cost_is_lowest():
    search, cost = Search(origin=(1.0, 2.0), size=(0.4, 0.2), step=0.1), np.ones((3, 5))
    cost[1, 3] = 0.5
    floor = cost_floor(cost, search)
    np.testing.assert_allclose(floor.lowest, [(1.3, 2.1)])
    bare = primitives.Picture(primitives.LIGHT, (1.0, 2.0, 1.4, 2.2), (1.0, 2.0, 1.4, 2.2), 0.01)
    diamond = next(solid for solid in with_floor(bare, floor).meshes if solid.name == "lowest")
    np.testing.assert_allclose(diamond.vertices.mean(axis=0)[:2], floor.lowest[0], atol=1e-6)
    assert with_floor(bare, None).meshes == ()
    # A browser takes a name as a path, and draws what is below the map's node relative to it.
    assert not any(solid.name.startswith("map") for solid in with_floor(bare, floor).meshes)


@pytest.mark.parametrize("log", [False, True])
def test_colours_reach_from_the_2nd_to_the_98th_percentile_over_four_decades_at_most(log):
    """The map of a random start spans a tenth of a decibel, and its extreme costs must not use up the colours."""
    search = Search(origin=(0.0, 0.0), size=(0.9, 0.9), step=0.1)
    cost = 10 ** (np.linspace(-14.1, -14.0, 100).reshape(10, 10) / 10)
    cost[0, 0], cost[9, 9] = 1e-9, 10.0
    floor = cost_floor(cost, search, log, relief=True)
    ends = np.percentile(10 * np.log10(cost), [2, 98]) if log else np.percentile(cost, [2, 98])
    np.testing.assert_allclose([floor.bar.low, floor.bar.high], ends, atol=1e-5)
    assert ("(dB)" in floor.bar.label) == log
    assert np.ptp(floor.heights) == pytest.approx(RELIEF_HEIGHT, rel=1e-5), "of all costs"
    wide = cost_floor(np.logspace(-9, 1, 100).reshape(10, 10), search, True).bar
    assert wide.high - wide.low == pytest.approx(40.0)
    level = cost_floor(1 + 1e-6 * cost, search, True).bar
    assert level.high - level.low == pytest.approx(0.01)


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize("value", [0.0, 3.0])
def test_a_flat_map_is_drawn_too(value, log):
    floor = cost_floor(np.full((2, 4), value), Search(origin=(0.0, 0.0), size=(0.3, 0.1), step=0.1), log=log)
    assert np.isfinite([share for share, _ in floor.bar.ticks]).all() and floor.bar.low < floor.bar.high


@pytest.mark.parametrize(
    "ends",
    [
        (1e-6, 3.0), (3e-9, 4e5), (0.9, 1.1), (2.0, 50.0), (71.6, 86.0), (330.0, 361.0), (4221.0, 8700.0),
        (14830.1, 14930.7), (2e4, 2e5), (1e5, 9e5),
    ],
)  # fmt: skip
def test_ticks_stand_at_their_values(ends):
    bar = primitives.ColourBar(*ends, "cost")
    assert 2 <= len(bar.ticks) <= 7
    assert len({text for _, text in bar.ticks}) == len(bar.ticks), "two ticks say the same"
    for (left, one), (right, other) in itertools.pairwise(bar.ticks):
        assert (right - left) * 44 > (len(one) + len(other)) / 2, "44 letters fit along a bar"
    for share, text in bar.ticks:
        assert read(text) == pytest.approx(bar.low + share * (bar.high - bar.low), rel=1e-2)


PLAIN = {chr(high): chr(low) for low, high in primitives.SUPERSCRIPTS.items()}


def read(text: str) -> float:
    """Return the value of a number as the pictures write it."""
    mantissa, ten, power = text.rpartition("10") if any(letter in PLAIN for letter in text) else (text, "", "")
    if not ten:
        return float(text)
    return float(mantissa.rstrip("·") or 1) * 10.0 ** int("".join(PLAIN[letter] for letter in power))


@pytest.mark.parametrize("value", [3.14159e7, 1e6, 2e-9, -4e12, 123456.0, 28338.2, 0.25, 1e-5, 999999.9])
def test_numbers_are_written_without_exponents(value):
    ticks = primitives.ColourBar(min(value, 0.0), max(value, 0.0), "").ticks
    assert len(ticks) > 1 and all("e" not in text and len(text) <= 8 for _, text in ticks)
    for fraction, text in ticks:
        assert read(text) == pytest.approx(min(value, 0.0) + fraction * abs(value), rel=6e-3)


# The matrices act on linear RGB: Vienot et al., Color Res. Appl. 24 (1999), 243. Rows sum to one: white stays white.
EYES = {
    "all cones": np.eye(3),
    "no L cones": np.array([[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]]),
    "no M cones": np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]]),
}
APART = 15  # in CIELAB, where a difference of two is just visible between adjacent colours


def lab(colours, eye):
    """CIELAB (D65) of sRGB colours (P, 3), 0 to 255, as an eye sees them."""
    rgb = np.asarray(colours, float).reshape(-1, 3) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ EYES[eye].T, 0, 1)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = np.clip(linear, 0, 1) @ to_xyz.T / to_xyz.sum(axis=1)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def rgb(text):
    return tuple(round(255 * share) for share in matplotlib.colors.to_rgb(text))


MARKS = {"true": marks.TRUE, "estimate": marks.ESTIMATE, "known": marks.KNOWN, "lowest": marks.LOWEST}
ENDS = 255 * matplotlib.colormaps[primitives.COLOUR_MAP]([0.0, 1.0])[:, :3]
ON_MAP = {**MARKS, "faulty": marks.FAULTY, "low": ENDS[0], "high": ENDS[1]}
MARKS["halo"] = marks.HALO
TRACES = {"trail": marks.TRAIL, "ellipse": marks.ELLIPSE, "estimate": marks.ESTIMATE, "known": marks.KNOWN}
CURVES = {"mean": rgb(plots.RED), "largest": rgb(plots.ORANGE), "cost": rgb(plots.BLUE)}
MODES = {"in": rgb(plots.BLUE), "out": rgb(plots.ORANGE), "spectrum": rgb(html.GREY)}


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize(
    "palette", [MARKS, ON_MAP, TRACES, CURVES, MODES], ids=["marks", "map", "traces", "curves", "modes"]
)
def test_colours_of_one_picture_are_distinguishable(palette, eye):
    places = dict(zip(palette, lab(list(palette.values()), eye), strict=True))
    for one, other in itertools.combinations(palette, 2):
        assert np.linalg.norm(places[one] - places[other]) > APART, (one, other)


@pytest.mark.parametrize("eye", EYES)
def test_a_map_grows_lighter_with_the_cost_for_every_eye(eye):
    colours = 255 * matplotlib.colormaps[primitives.COLOUR_MAP](np.linspace(0, 1, 64))[:, :3]
    assert (np.diff(lab(colours, eye)[:, 0]) > 0).all()
    low, middle, high = lab(255 * matplotlib.colormaps[primitives.DIVERGING_COLOUR_MAP]([0.0, 0.5, 1.0])[:, :3], eye)
    assert min(np.linalg.norm(low - high), np.linalg.norm(low - middle), np.linalg.norm(high - middle)) > APART


def contrast(one, other):
    """The contrast of two sRGB colours by WCAG 2, 1 to 21."""
    fractions = np.array([one, other]) / 255
    linear = np.where(fractions <= 0.04045, fractions / 12.92, ((fractions + 0.055) / 1.055) ** 2.4)
    dark, bright = sorted(linear @ (0.2126, 0.7152, 0.0722))
    return (bright + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("theme", [primitives.LIGHT, primitives.DARK], ids=["light", "dark"])
def test_texts_stand_out_from_their_background(theme):
    """Contrast of at least 7, the strictest of the Web Content Accessibility Guidelines."""

    assert contrast((0, 0, 0), (255, 255, 255)) == pytest.approx(21)
    assert contrast(theme.background, theme.foreground) > 7
    assert contrast(theme.background, primitives.mixed(theme.foreground, theme.background, FAINTER)) > 4.5
    shapes = [(entry.paths, entry.filled) for entry in marks.MARKS.values() if entry.text and entry.line_halo]
    assert len(shapes) == len(set(shapes)) == 10, "every mark has a shape of its own, too"
