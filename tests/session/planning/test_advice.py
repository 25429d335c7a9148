"""Advice is right: simulated fields and calibrations of the real solver, with seeds of their own, bear it out."""

from dataclasses import replace

import numpy as np
import pytest

from fdcal.assessment.uncertainty import field_information, position_bound
from fdcal.model.gauge import fixes_gauge
from fdcal.session.planning.advice import accuracy_advice, best_addition, best_tape, resized
from fdcal.session.planning.bounds import field_of, forecast, information_at, request_information, wavenumbers_of
from fdcal.session.planning.request import ASSUMED, PlanRequest, read_layout
from fdcal.session.planning.trials import run_trials

FIELDS = 6  # drawn for a bound
OTHERS = 9  # places, or choices of microphones, beside the one that is advised
LAYOUTS = {
    "rectangle 4x3 0.6x0.4": {"known": (0, 3, 8), "room": (6.0, 5.0)},
    "rectangle 3x3 0.4x0.4": {"known": (0, 2, 6), "room": (6.0, 5.0)},
    "rectangle 4x4 0.5x0.5": {"known": (0, 3, 12)},
}


def request_of(text, **others):
    return PlanRequest(read_layout(text), **(LAYOUTS.get(text, {}) | others))


def advice_of(request):
    """Return what reaches the accuracy, by the error that is forecast."""
    return accuracy_advice(request)


def expected_error(request):
    """Return the error that is forecast, metres."""
    information = request_information(request)
    return forecast(request, information, position_bound(information, request.prior)).rms


def with_extra(request: PlanRequest, place) -> PlanRequest:
    """Return `request` with one more microphone, the last, at `place` (D,), metres."""
    layout = request.layout
    positions = np.vstack([layout.positions, place])
    names = (*layout.names, f"new {len(layout.names)}")
    return replace(request, layout=replace(layout, names=names, positions=positions))


def drawn_bound(request, microphones, seed=99):
    """Return the bound of the first microphones, root mean square in metres over fields of drawn sources."""
    used = request.spaced(40)
    k, square = wavenumbers_of(request, used), []
    for draw in range(FIELDS):
        p = field_of(request, used, np.random.default_rng([seed, draw]))
        found = field_information(request.layout.positions, p, k, request.noise_fraction, request.dimension)
        bound = position_bound(found.scaled(len(request.frequencies) / len(used)), request.prior)
        square.append(np.mean(bound.sigma[:microphones][bound.free[:microphones]] ** 2))
    return np.sqrt(np.mean(square))


def errors_of(request, trials, microphones=None):
    """Return root mean square errors, metres, of calibrations with seeds that no advice has seen."""
    request = replace(request, seed=request.seed + 1000)
    found = run_trials(request, request_information(request), trials)
    free = found.free & (np.arange(len(found.free)) < (microphones or len(found.free)))
    return np.sqrt(np.mean(found.errors[:, free] ** 2, axis=1))


def median_error(request, trials, microphones=None):
    return np.median(errors_of(request, trials, microphones))


def other_places(request):
    extra = best_addition(request)
    places = extra.places[np.isfinite(extra.rms) & (extra.rms > extra.best_rms)]
    return extra.best, places[np.random.default_rng(1).choice(len(places), OTHERS, replace=False)]


def test_the_best_place_for_one_more_microphone_beats_the_median_place_in_drawn_fields():
    request = request_of("circle 10 0.3")
    request, count = replace(request, band=request.limits), len(request.layout.positions)
    best, others = other_places(request)
    bounds = [drawn_bound(with_extra(request, place), count) for place in others]
    assert drawn_bound(with_extra(request, best), count) < min(np.median(bounds), drawn_bound(request, count))


def test_the_best_place_lowers_the_error_of_the_solver():
    request = request_of("circle 10 0.3", known=(0, 3, 6), room=(6.0, 5.0))
    request = replace(request, band=request.limits)
    extra = best_addition(request)
    places = extra.places[np.isfinite(extra.rms)]
    median = places[np.argsort(extra.rms[np.isfinite(extra.rms)])[len(places) // 2]]
    best_error, other_error = (median_error(with_extra(request, place), 3, 10) for place in (extra.best, median))
    assert best_error < other_error


def taped(request, chosen):
    return replace(request, known=tuple(chosen), known_sigma=ASSUMED.tape_sigma_m)


def other_choices(request, count):
    rng, x, found = np.random.default_rng(2), request.layout.positions, []
    while len(found) < OTHERS:
        chosen = np.sort(rng.choice(len(x), count, replace=False))
        if fixes_gauge(x[chosen]):
            found.append(tuple(chosen.tolist()))
    return found


def tape_choices(text):
    """Return a request, the choice that is advised, and others with their bounds in drawn fields, metres, ascending."""
    request = request_of(text, known=())
    best = best_tape(request, request_information(request)).microphones
    count = len(request.layout.positions)
    bounds = {chosen: drawn_bound(taped(request, chosen), count) for chosen in other_choices(request, len(best))}
    return request, best, sorted(bounds.items(), key=lambda pair: pair[1])


def test_the_microphones_to_measure_by_tape_beat_the_median_choice_in_drawn_fields():
    request, best, others = tape_choices("circle 10 0.3")
    assert drawn_bound(taped(request, best), len(request.layout.positions)) < others[len(others) // 2][1]


def test_the_advised_ratio_reaches_the_accuracy():
    """The median error of calibrations is at most a quarter above the accuracy, and no less than a third of it."""
    request = request_of("rectangle 4x3 0.6x0.4", snr_db=10.0, accuracy=0.008)
    advice = advice_of(request)
    assert advice.snr_db is not None and advice.snr_db > 10
    assert 1 / 3 < median_error(replace(request, snr_db=advice.snr_db), 4) / request.accuracy < 1.25


def test_advice_on_noise_and_size_of_impulses_reaches_the_accuracy_by_the_forecast_itself():
    """Arrival times do not change with noise, so that the error over the bound does."""
    request = PlanRequest(
        read_layout("ball 16 0.3"), room=(5.0, 4.0, 3.0), takes=4, kind="impulse", accuracy=0.008, snr_db=10.0
    )
    advice = advice_of(request)
    assert advice.snr_db is not None and advice.size is not None
    reached = [expected_error(one) for one in (replace(request, snr_db=advice.snr_db), resized(request, advice.size))]
    np.testing.assert_allclose(reached, request.accuracy, rtol=0.1)


def test_a_ratio_is_not_advised_where_noise_is_not_the_limit():
    """The bound of ten microphones on a circle still falls beyond 40 dB, while calibrations no longer follow it."""
    request = request_of("circle 10 0.3", known=(0, 3, 6), room=(6.0, 5.0), accuracy=0.003)
    assert advice_of(request).snr_db is None
    assert position_bound(information_at(request, 70.0), request.prior).rms < request.accuracy
    assert median_error(replace(request, snr_db=50.0), 3) > request.accuracy


@pytest.mark.parametrize(("text", "factor"), [("rectangle 4x3 0.6x0.4", 0.7), ("rectangle 3x3 0.4x0.4", 2.5)])
def test_the_advised_size_is_right_in_direction(text, factor):
    """An accuracy of `factor` times the bound: what reaches it does, what is twice as large does not."""
    request = request_of(text)
    request = replace(request, accuracy=factor * position_bound(request_information(request), request.prior).rms)
    size = advice_of(request).size
    assert size is not None and (size < 1) == (factor < 1.5)
    present = median_error(request, 3) <= request.accuracy
    assert present == (size >= 1)
    assert median_error(resized(request, size), 3) <= 1.25 * request.accuracy
    assert median_error(resized(request, 2 * size), 3) > request.accuracy


def test_the_advised_size_of_a_plane_array_in_a_room_of_three_dimensions_reaches_the_accuracy():
    """The bound takes waves from all directions for equally strong, and determines its size from that."""
    layout = read_layout("rectangle 4x4 0.6x0.6")
    request = PlanRequest(
        layout, room=(7.0, 6.0, 2.7), reverberation_time=0.4, snr_db=30.0, known=(0, 3, 12), accuracy=0.01
    )
    size = advice_of(request).size
    assert size is not None and size < 1
    assert median_error(request, 3) > request.accuracy
    assert median_error(resized(request, size), 3) <= request.accuracy
