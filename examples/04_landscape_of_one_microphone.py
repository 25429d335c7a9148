"""Draw the cost of moving one microphone: it has many minima at each frequency, and only one is common to all.

Usage: python 04_landscape_of_one_microphone.py [SCENE]
"""

import sys

import numpy as np

import fdcal

measurement = fdcal.load(sys.argv[1] if len(sys.argv) > 1 else "fig1_square")
microphone = measurement.count - 1
count = len(measurement.frequencies)
panels = fdcal.landscape(measurement, microphone, modes=[count // 4, count // 2, 3 * count // 4])

true = measurement.positions[microphone]
for mode, minimum in zip([*panels.modes, "all"], panels.minima, strict=True):
    print(f"frequency {mode}: minimum {np.linalg.norm(minimum - true):.3f} m from the microphone")
panels.plot(true).savefig("landscape.png")
