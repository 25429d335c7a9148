"""Check somebody's list of positions against what the channels recorded: which microphones are swapped?

The list comes as a file of Acoular; here two of its rows are swapped on purpose.
"""

from pathlib import Path

import fdcal

rows = fdcal.simulate("tiny").positions.tolist()
rows[3], rows[12] = rows[12], rows[3]  # the mistake
lines = [f'  <pos Name="Point {n}" x="{x}" y="{y}" z="0"/>' for n, (x, y) in enumerate(rows)]
Path("geometry.xml").write_text("\n".join(["<MicArray>", *lines, "</MicArray>"]), encoding="utf-8")

measurement = fdcal.load("tiny", positions="geometry.xml")
found = fdcal.calibrate(measurement)
check = fdcal.compare_positions(found.positions, measurement.positions, measurement.known)

print(f"{found.verdict}: {found.verdict_text}")
for first, second in check.swapped:
    print(f"channels {first} and {second} are swapped")
