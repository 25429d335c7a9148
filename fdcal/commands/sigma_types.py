"""Types of command-line values with a unit: the standard deviations that solver robust assumes."""

from __future__ import annotations

import re
import typing
from typing import Any

import click


class GainSigma(click.ParamType):
    """Standard deviation of the channels' gains and phases, such as "1dB,5deg"."""

    name = "gain-sigma"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        if isinstance(value, tuple):
            return value
        number = r"([0-9.]+(?:e-?[0-9]+)?)"
        match = re.fullmatch(rf"{number}\s*dB\s*,\s*{number}\s*deg", value.strip(), re.IGNORECASE)
        try:
            if match is None:
                raise ValueError
            gain, phase = float(match[1]), float(match[2])
        except ValueError:
            self.fail(f'"{value}" must be decibels and degrees with their units, as 1dB,5deg', param, ctx)
        return gain, phase


class Length(click.ParamType):
    """A length with its unit, such as "5mm"; metres."""

    name = "length"
    UNITS: typing.ClassVar = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, float):
            return value
        match = re.fullmatch(r"([0-9.]+(?:e-?[0-9]+)?)\s*(mm|cm|m)", value.strip())
        try:
            if match is None:
                raise ValueError
            return float(match[1]) * self.UNITS[match[2]]
        except ValueError:
            self.fail(f'"{value}" must be a length with its unit, mm, cm or m, as 5mm', param, ctx)


class Decibels(click.ParamType):
    """A number of decibels with its unit, such as "1dB"."""

    name = "decibels"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, float):
            return value
        match = re.fullmatch(r"([0-9.]+(?:e-?[0-9]+)?)\s*dB", value.strip(), re.IGNORECASE)
        try:
            if match is None:
                raise ValueError
            return float(match[1])
        except ValueError:
            self.fail(f'"{value}" must be decibels with their unit, as 1dB', param, ctx)


class Percentage(click.ParamType):
    """A part of something with its sign, such as "0.3%"; 0.003."""

    name = "percentage"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, float):
            return value
        match = re.fullmatch(r"([0-9.]+(?:e-?[0-9]+)?)\s*%", value.strip())
        try:
            if match is None:
                raise ValueError
            return float(match[1]) / 100
        except ValueError:
            self.fail(f'"{value}" must be a number of percent with its sign, as 0.3%', param, ctx)
