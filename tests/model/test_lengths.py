"""Lengths are written without exponents, in metres from one on."""

from __future__ import annotations

import pytest

from fdcal.model.texts import length_text


@pytest.mark.parametrize(
    ("length", "digits", "text"),
    [
        (0.0, 3, "0 mm"),
        (0.00413, 3, "4.13 mm"),
        (0.0182, 2, "18 mm"),
        (0.0996, 2, "100 mm"),
        (0.45, 2, "450 mm"),
        (1.164, 3, "1.16 m"),
        (23.2, 3, "23.2 m"),
        (23214.6, 2, "23215 m"),
    ],
)
def test_lengths_have_no_exponent(length, digits, text):
    assert length_text(length, digits) == text
