"""Find 64 microphones in a ball in a room, none of which is known.

Without a known microphone the array is found up to rotation, translation and mirror image.
"""

import fdcal

measurement = fdcal.load("ball3d")
found = fdcal.calibrate(measurement, known="none", progress=lambda done, note: None)

print(f"{found.verdict}: {found.verdict_text}")
print(f"mean error {1000 * found.mean_error:.1f} mm after the best rigid motion: {found.aligned}")
found.export("ball.csv", frame="axes", force=True)  # the centre is the origin, x the longest axis
found.plot().savefig("ball.png")  # a plan and a side view
