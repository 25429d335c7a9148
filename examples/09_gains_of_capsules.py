"""Gain and phase of cheap capsules: a loudspeaker in a room compares them without an anechoic chamber."""

from dataclasses import replace

import numpy as np

import fdcal

rng = np.random.default_rng(9)
room = fdcal.load("two_places")
decibels, degrees = rng.normal(scale=1.5, size=room.count), rng.normal(scale=10, size=room.count)
gains = 10 ** (decibels / 20) * np.exp(1j * np.radians(degrees))

found = fdcal.calibrate(replace(room, pressures=room.pressures * gains))
found.export("gains.csv", table="gains", force=True)
found.export("calib.xml", table="gains", force=True)  # factors for Acoular

channels = found.channels  # relative to the median channel
for name, estimated, true, unit in (
    ("gain", channels.gain_db, decibels, "dB"),
    ("phase", channels.phase_deg, degrees, "degrees"),
):
    error = estimated - true
    error = error - np.median(error)
    print(f"{name}: spread {np.std(true):.1f} {unit}, found to {np.sqrt(np.mean(error**2)):.3f} {unit} RMS")
