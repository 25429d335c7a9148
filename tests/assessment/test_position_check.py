"""A list is compared by its shape: its faults are named whatever its order, place, size or mirror image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from running import refuses

from fdcal.assessment.findings import FINDINGS
from fdcal.assessment.position_check import compare_positions, fit_list
from fdcal.assessment.words import comparison_sentences, list_faults


def described(*arguments, **others) -> str:
    return "\n".join(comparison_sentences(*arguments, **others))


ERROR = 0.003  # m, standard deviation of each estimated coordinate


def ball(seed: int, count: int, dimension: int, radius: float = 0.3) -> np.ndarray:
    """Positions in a disk or ball, none close to another, as somebody hangs microphones up."""
    rng, places = np.random.default_rng(seed), []
    while len(places) < count:
        place = rng.uniform(-radius, radius, dimension)
        apart = 0.9 * radius / count ** (1 / dimension)
        if np.linalg.norm(place) < radius and all(np.linalg.norm(place - other) > apart for other in places):
            places.append(place)
    return np.array(places)


def plane(seed: int, count: int) -> np.ndarray:
    """Positions in a plane of space."""
    return np.column_stack([ball(seed, count, 2), np.zeros(count)])


def moved(places: np.ndarray, seed: int, mirrored: bool = False, error: float = ERROR) -> np.ndarray:
    """The positions as a calibration finds them: somewhere, turned, maybe mirrored, with errors."""
    rng = np.random.default_rng(seed + 1)
    turn = np.linalg.qr(rng.normal(size=(places.shape[1],) * 2))[0]
    turn[0] *= (-1 if mirrored else 1) * np.sign(np.linalg.det(turn))
    return places @ turn + rng.normal(size=places.shape[1]) + error * rng.normal(size=places.shape)


ARRAYS = {
    "plane16": lambda seed: ball(seed, 16, 2),
    "space32": lambda seed: ball(seed, 32, 3),
    "plane in space": lambda seed: plane(seed, 16),
}
ORDERS = {
    "as it is": lambda own, rng: own,
    "reversed": lambda own, rng: own[::-1],
    "shuffled": lambda own, rng: rng.permutation(own),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("array", ARRAYS)
def test_the_order_of_a_list_is_found(array, order):
    seed, mirrored = (0, False) if order == "reversed" else (1, True)
    places = ARRAYS[array](seed)
    wanted = ORDERS[order](np.arange(len(places)), np.random.default_rng(seed))
    check = compare_positions(moved(places[wanted], seed, mirrored), places)
    np.testing.assert_array_equal(check.order, wanted)
    assert check.fits and check.scale == 1 and not check.symmetric and check.distances.max() < 6 * ERROR
    assert check.agrees == (order == "as it is")


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 200), st.sampled_from([2, 3]), st.sampled_from([16, 32]), st.integers(1, 8), st.booleans())
def test_pairs_are_named(seed, dimension, count, pairs, mirrored):
    places = ball(seed % 10, count, dimension)
    chosen = np.random.default_rng(seed).permutation(count)[: 2 * pairs].reshape(-1, 2)
    found = places.copy()
    found[chosen] = found[chosen[:, ::-1]]
    check = compare_positions(moved(found, seed, mirrored), places)
    assert set(check.swapped) == {tuple(sorted(pair)) for pair in chosen.tolist()}
    assert check.permuted == () and check.fits and not check.agrees
    names = [f"m{n}" for n in range(count)]
    for a, b in check.swapped if 4 * pairs <= count else ():
        assert f"channels m{a} and m{b} are swapped" in described(check, names)


@pytest.mark.parametrize("array", ARRAYS)
def test_the_list_of_another_array_fits_in_no_order(array):
    check = compare_positions(moved(ARRAYS[array](0), 0), ARRAYS[array](50))
    assert not check.fits and not check.agrees
    assert check.scale == 1 or not 0.91 < check.scale < 1.1, "nothing shows so small a factor"
    assert (check.swapped, check.permuted) == ((), ()) and np.array_equal(check.order, np.arange(len(check.order)))
    for verdict in ("good", "model_mismatch"):
        text = described(check, range(len(check.errors)), verdict)
        assert text.startswith("the list does not fit the array found in any order") and "at the place of" not in text
        assert "no channels are swapped" not in text and "another array" in text


@pytest.mark.parametrize(("array", "factor", "unit"), [
    ("plane16", 100.0, "centimetres"), ("space32", 1000.0, "millimetres"), ("plane in space", 1.3, None),
])  # fmt: skip
def test_a_list_of_another_size_is_still_matched(array, factor, unit):
    places = ARRAYS[array](1)
    wanted = np.roll(np.arange(len(places)), 2)
    check = compare_positions(moved(places[wanted], 1), factor * places)
    np.testing.assert_array_equal(check.order, wanted)
    assert check.fits and not check.agrees and check.distances.max() < 6 * ERROR
    assert check.scale == pytest.approx(factor, rel=0.01)
    text = described(check, range(len(places)))
    assert f"is it in {unit}?" in text if unit else "times as large as the array found;" in text


def test_swaps_are_found_beside_displaced_microphones_and_in_a_cycle_of_three():
    places = ball(0, 20, 3)
    found = places.copy()
    found[[4, 9, 15]] = places[[9, 15, 4]]
    check = compare_positions(found, places)
    assert check.permuted == ((4, 9, 15),)
    assert "channels 4, 9, 15 are swapped in a cycle" in described(check, range(20))
    places = ball(3, 16, 3)
    found = places.copy()
    found[[2, 7]] = found[[7, 2]]
    found[[0, 5, 11]] += [[0.2, 0, 0], [0, 0.25, 0], [0, 0, -0.3]]
    check = compare_positions(moved(found, 3), places)
    assert (check.swapped, check.permuted) == (((2, 7),), ())
    assert set(np.argsort(check.distances)[-3:]) == {0, 5, 11}


def test_a_rotated_list_of_a_regular_circle_cannot_be_distinguished_from_the_right_one():
    angles = 2 * np.pi * np.arange(16) / 16
    circle = 0.2 * np.column_stack([np.cos(angles), np.sin(angles)])
    check = compare_positions(moved(np.roll(circle, 1, axis=0), 0, error=0.001), circle)
    assert check.fits and check.symmetric and check.agrees
    assert "rotated or mirrored" in described(check, range(16))
    fixed = compare_positions(np.roll(circle, 1, axis=0), circle, known=[0, 4, 8])
    assert not fixed.agrees or fixed.moved


def test_known_microphones_fix_the_axes_unless_the_list_has_others():
    places = ball(4, 20, 3)
    found = places + ERROR * np.random.default_rng(4).normal(size=places.shape)
    check = compare_positions(found, places, known=[0, 1, 2, 3])
    np.testing.assert_allclose(check.errors, np.linalg.norm(found - places, axis=1))
    assert not check.moved and check.agrees
    other = compare_positions(moved(places, 4), places, known=[0, 1, 2, 3])
    assert other.moved and other.agrees and "different axes" in described(other, range(20))


@settings(deadline=None, max_examples=8)
@given(st.integers(0, 200))
def test_position_errors_are_not_taken_for_swaps(seed):
    places = ball(seed % 10, 20, 3, 0.5)
    check = compare_positions(places + 0.02 * np.random.default_rng(seed).normal(size=places.shape), places)
    assert check.agrees and (check.swapped, check.permuted) == ((), ())
    assert described(check, range(20)).startswith("no channels are swapped")


CODES = {one.code for one in FINDINGS} - {"good"}


def test_without_a_good_verdict_swaps_are_excluded_only_if_all_are_near_their_places():
    assert {"scale_undetermined", "undersampled", "sound_speed"} <= CODES
    places = ball(5, 16, 3)
    near = compare_positions(moved(places, 5), places)
    off = np.random.default_rng(0).normal(size=places.shape)
    far = compare_positions(places + 0.1 * off / np.linalg.norm(off, axis=1, keepdims=True) * np.eye(16)[:1].T, places)
    for code in CODES:
        assert described(near, range(16), code).startswith("no swap is detected: the largest distance, "), code
        assert described(far, range(16), code).startswith("swaps cannot be detected"), code
        assert "--known none" in described(far, range(16), code, arguments={"known": "--known"})
        assert "known none" not in described(far, range(16), code, known=False)


def faults_of(listed, found, scale: float = 1.0) -> list[str]:
    """Return the faults of a list, except its order, for an array found with errors of 1 mm in each coordinate."""
    check = compare_positions(found, scale * listed)
    assert check.agrees
    sigma = np.full(len(found), 1e-3 * np.sqrt(found.shape[1]))
    return list_faults(check, fit_list(check, found, scale * listed, sigma), range(len(found)))


@pytest.mark.parametrize("seed", range(4))
def test_a_list_that_is_wrong_everywhere_neither_fits_nor_is_explained_by_a_temperature(seed):
    places, error = ball(seed, 16, 3), (0.015, 0.025)[seed % 2]
    listed = places + error * np.random.default_rng(seed).normal(size=places.shape)
    (words,) = faults_of(listed, moved(places, seed, error=1e-3), (1.0, 1.03)[seed % 2])
    assert words.endswith("mm off (RMS)") and float(words.split()[4]) == pytest.approx(1e3 * error * 3**0.5, rel=0.4)


def test_a_row_that_is_wrong_is_named_whatever_the_verdict_if_the_other_rows_confirm_the_array():
    places, rng = ball(3, 16, 3), np.random.default_rng(3)
    listed = places + 0.25 * np.eye(16)[5][:, None] * (0.6, 0.8, 0.0)
    for error, misplaced in ((0.005, (5,)), (0.06, ())):
        found = moved(places, 3) + error * rng.normal(size=places.shape)
        check = compare_positions(found, listed)
        fit = fit_list(check, found, listed, np.full(16, 0.01), "ambiguous")
        assert check.fits and fit.misplaced == misplaced and fit.wrong == bool(misplaced)
    found = moved(places, 3)
    text = described(compare_positions(found, listed), range(16), "ambiguous", fit=replace(fit, misplaced=(5,)))
    assert "5 is " in text and "mm off (RMS)" not in text
    listed = places * np.where(np.arange(16) < 6, 100.0, 1.0)[:, None]  # these rows are in centimetres
    check = compare_positions(found, listed)
    assert check.scale == 1 and fit_list(check, found, listed).misplaced == tuple(range(6))


def test_a_position_that_the_list_has_twice_is_named_though_both_microphones_stand_near_it():
    listed, found = ball(3, 16, 3), moved(ball(3, 16, 3), 3)
    found[9], listed[9] = found[4] + [0.004, 0.0, 0.0], listed[4]
    check = compare_positions(found, listed)
    fit = fit_list(check, found, listed, np.full(16, 0.005))
    assert fit.repeated == (4, 9) and fit.wrong and not fit.misplaced
    (words,) = list_faults(check, fit, range(16))[len(check.swapped) :]
    assert words == "the list gives the same position to more than one microphone: 4, 9"


@pytest.mark.parametrize("away", [0.03, 0.5])
def test_a_dead_channel_counts_nowhere_in_the_fit_of_a_list(away):
    places = ball(4, 8, 3)
    found = places + 1e-4 * np.random.default_rng(4).normal(size=places.shape)
    found[5, 0] += away
    check = compare_positions(found, places)
    assert fit_list(check, found, places).misplaced == (5,)
    fit = fit_list(check, found, places, dead=[5])
    assert list_faults(check, fit, range(8)) == [] and not fit.kept[5] and fit.rms < 1e-3
    others = np.delete(np.arange(8), 5)
    alone = fit_list(compare_positions(found[others], places[others]), found[others], places[others])
    assert fit.rms == pytest.approx(alone.rms, rel=0.01) and fit.scale == pytest.approx(alone.scale)


@pytest.mark.parametrize("array", ARRAYS)
def test_a_list_by_a_tape_measure_fits_and_its_wrong_size_is_still_detected(array):
    for seed in range(2):
        places = ARRAYS[array](seed)
        found = moved(places, seed, error=1e-3)
        listed = places + 0.003 * np.random.default_rng(seed).normal(size=places.shape)
        assert faults_of(listed, found) == []
        for factor, words in ((1.06, "warmer"), (0.94, "colder")):
            (line,) = faults_of(listed, found, factor)
            assert ("% too large" if factor > 1 else "% too small") in line and line.endswith(f"{words} than assumed")


@pytest.mark.parametrize("count", [1, 2, 3, 4, 200])
def test_few_microphones_are_compared_in_their_order_and_many_in_any(count):
    places = ball(6, count, 3, max(0.3, count / 130))
    wanted = np.random.default_rng(7).permutation(count) if count > 4 else np.arange(count)
    check = compare_positions(places[wanted] + 1.0, places)
    np.testing.assert_array_equal(check.order, wanted)
    assert check.fits and check.distances.max() < 1e-9 and check.agrees == (count <= 4)


def test_positions_that_do_not_fit_or_are_not_finite_are_refused():
    places = ball(8, 8, 3)
    refuses("shape", compare_positions, places[:7], places)
    refuses("different lengths", compare_positions, [[1, 2], [1]], places)
    refuses("give a row of coordinates per microphone", compare_positions, places[:0], places[:0])
    refuses("not a finite number", lambda: compare_positions(np.where(np.eye(8)[:, :3] > 0, np.nan, places), places))
    for one, other in ((np.zeros((8, 3)), places), (places, np.zeros((8, 3)))):
        assert not compare_positions(one, other).fits, "an array collapsed to a point fits nothing"
