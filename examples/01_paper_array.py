"""Calibrate the paper's array 1 and plot it.

Usage: python 01_paper_array.py [SCENE]
The first run simulates 4 s of sound, which takes about ten seconds; later runs read it from the cache.
"""

import sys

import fdcal

measurement = fdcal.load(sys.argv[1] if len(sys.argv) > 1 else "array1_circle")
known = measurement.known.tolist()
print(f"{measurement.count} microphones, {len(measurement.frequencies)} frequencies, known: {known}")

found = fdcal.calibrate(measurement)  # the solver gets the pressures and the known positions, not the others
print(f"{found.verdict}: {found.verdict_text}")
print(f"mean error {1000 * found.mean_error:.2f} mm, largest {1000 * found.max_error:.2f} mm")

found.plot(measurement.positions).savefig("array.png")
found.save("array.json", force=True)
