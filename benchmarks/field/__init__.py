"""A generator of calibration cases, and their score. `fdcal` draws the noise only; the fields use none of its code,
except in the families of a study, which are draws of `fdcal_bench.draw`.

families    lists of case descriptions, each fixed by its seed
cases       from a case description to the content of a measurement file and the truth
faults      what goes wrong in a case: channels, given positions, sound speed
geometries  array shapes
rectangle   rigid rectangle in two dimensions, closed form
boxes       rooms of three dimensions: image sources, pyroomacoustics
finite_elements   rooms of other shapes with absorbing walls
bound       Cramer-Rao bound of a diffuse field
score       one calibration through the command line, compared with the truth
"""
