"""What a beamformer gains from a calibration: maps of two sources before and after it.

The beamformer is delay-and-sum for plane waves at one frequency. Acoular draws the same maps from
`found.export("array.xml")` and `found.export("calib.xml", table="gains")`; here a few lines of NumPy draw them.
"""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import fdcal

rng = np.random.default_rng(8)
room = fdcal.load("two_places")  # 24 microphones in a ball of 0.3 m, four of them known
true, count = room.positions, room.count
gains = 10 ** (rng.normal(scale=1.5, size=count) / 20) * np.exp(1j * np.radians(rng.normal(scale=10, size=count)))
gains[5] *= -1  # a cable with the wrong polarity
listed = true + rng.normal(scale=0.02, size=true.shape)  # a list that is 2 cm off in each coordinate
found = fdcal.calibrate(replace(room, pressures=room.pressures * gains))

k, (azimuth, elevation) = 2 * np.pi * 2000 / room.sound_speed, np.meshgrid(*2 * [np.radians(np.arange(-60, 60.5))])
aims = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1)
sources = aims[[70, 45], [40, 85]]  # two directions, the second source 10 dB weaker
recorded = gains * (np.exp(1j * k * true @ sources.T) @ [1, 10 ** (-10 / 20)])


def beam_map(positions, signals) -> np.ndarray:
    """Return the amplitude in every direction; the stronger source alone would give 1."""
    return np.abs(np.exp(-1j * k * aims @ positions.T) @ signals) / count


corrected = recorded / found.channels.correction.gains
maps = {"true": beam_map(true, recorded / gains), "before": beam_map(listed, recorded)}
maps["after"] = beam_map(found.positions, corrected)
figure = Figure(figsize=(12, 4), layout="constrained")
panels = figure.subplots(1, 3)
for (name, amplitude), panel in zip(maps.items(), panels, strict=True):
    image = panel.imshow(20 * np.log10(amplitude), origin="lower", extent=(-60, 60, -60, 60), vmin=-15, vmax=1)
    panel.plot(*np.degrees([azimuth[[70, 45], [40, 85]], elevation[[70, 45], [40, 85]]]), "rx")
    panel.set(title=name, xlabel="azimuth (degrees)", ylabel="elevation (degrees)")
    difference = np.linalg.norm(amplitude - maps["true"]) / np.linalg.norm(maps["true"])
    print(f"{name}: differs from the map of the true array by {100 * difference:.1f} %")
figure.colorbar(image, ax=panels, label="dB")
figure.savefig("beamforming.png")
