"""BLAS has one thread while fdcal computes and as many as before afterwards; importing fdcal changes nothing."""

import os
from concurrent.futures import ThreadPoolExecutor

import pytest
from running import exit_code
from threadpoolctl import threadpool_info, threadpool_limits

import fdcal
from fdcal.session.process import one_blas_thread


def threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


@pytest.fixture
def two_threads():
    with one_blas_thread():  # the call loads all libraries
        pass
    with threadpool_limits(2, user_api="blas"):
        yield


def test_the_last_of_several_computations_restores_the_threads_also_after_an_error(two_threads):
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        raise ZeroDivisionError
    assert set(threads()) == {2}
    with ThreadPoolExecutor(1) as other, one_blas_thread() as own:
        computing = one_blas_thread()
        other.submit(computing.__enter__).result()
        other.submit(computing.__exit__, None, None, None).result()
        assert set(threads()) == {1}, "one of them still computes"
    assert set(threads()) == {2} and own is None


def test_a_calibration_or_a_command_has_one_thread_and_restores_the_others(two_threads):
    seen, measurement = [], fdcal.simulate("tiny")
    fdcal.calibrate(measurement, modes=8, progress=lambda done, note: seen.extend(threads()))
    assert set(seen) == {1} and set(threads()) == {2}
    before = dict(os.environ)
    exit_code("scenes")
    assert before == os.environ and set(threads()) == {2}
