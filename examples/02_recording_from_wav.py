"""Find the microphones of a WAV file, with one channel for each microphone and three positions measured by hand.

Here the file is written first, from a simulation; use your own instead.
"""

import soundfile

import fdcal
from fdcal.acoustics.measure import cached_recordings

scene = fdcal.load_scene("tiny")
recordings = cached_recordings(scene)  # (microphones, samples)
rate = int(scene.source.band.sample_rate)
soundfile.write("recording.wav", (recordings / abs(recordings).max()).T, rate, subtype="FLOAT")

# This room is simulated in a plane: a real one needs no `dimension`.
options = {"dimension": 2, "sound_speed": 343.0, "array_radius": 0.32}
measurement = fdcal.load("recording.wav", kind="impulse", frequencies="60:800", **options)
true = fdcal.simulate(scene).positions
found = fdcal.calibrate(measurement, known={n: true[n] for n in (0, 5, 7)})

print(f"{found.verdict}: {found.verdict_text}")
print(f"largest error {1000 * abs(found.positions - true).max():.1f} mm")
found.export("microphones.xml", force=True)  # for Acoular
