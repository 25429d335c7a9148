"""Simulate a room and an array of your own, and compare numbers of frequencies.

A scene is a frozen dataclass with the keys of its .toml file; `dataclasses.replace` returns a changed copy.
"""

from dataclasses import replace

import fdcal

tiny = fdcal.load_scene("tiny")
array = replace(tiny.array, shape=(4, 4), random=4)  # a grid of 4 x 4 and four at random
scene = replace(tiny, name="mine", title="Mine", array=array, gauge=replace(tiny.gauge, known=(0, 3, 12)))
measurement = fdcal.simulate(scene)

for modes in (6, 9, 12):
    found = fdcal.calibrate(measurement, modes=modes, settings=scene.solver)
    print(f"{modes:3} frequencies: {found.verdict:<12} mean error {1000 * found.mean_error:6.2f} mm")
