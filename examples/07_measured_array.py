"""Find seven real microphones from four takes: recordings with the loudspeaker at four places.

The recordings are impulse responses of a laboratory from R3VIVAL (CC BY 4.0, see frl_array/LICENSE.md). Six microphones
are on a sphere of 5 cm radius, and one is at its centre.
"""

from pathlib import Path

import numpy as np

import fdcal

folder = Path(__file__).parent / "frl_array"
takes = sorted(folder.glob("source*.flac"))
measurement = fdcal.load(takes, positions=folder / "nominal.csv", temperature=20.0)
found = fdcal.calibrate(measurement)

print(f"{measurement.take_count} takes, {len(measurement.frequencies)} frequencies; verdict {found.verdict}")
print(f"RMS distance to the nominal positions {1000 * found.rms_error:.1f} mm")
size, nominal = (np.linalg.norm(x - x.mean(axis=0)) for x in (found.positions, measurement.positions))
print(f"size: {size / nominal:.2f} times the nominal one")
found.export("array.xml", force=True)  # for Acoular
found.plot(measurement.positions, "nominal").savefig("measured-array.png", dpi=110)
