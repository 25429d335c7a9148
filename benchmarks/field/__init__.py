"""A generator of calibration cases, and their score. Their fields use no code of `fdcal`; the noise is drawn by it.

families    lists of case descriptions, each fixed by its seed
cases       a case description to the content of a measurement file and the truth
faults      what goes wrong in a case: channels, given positions, sound speed
geometries  array shapes
rectangle   rigid rectangle in two dimensions, closed form
boxes       rooms of three dimensions: image sources, pyroomacoustics
finite_elements   rooms of other shapes with absorbing walls
bound       Cramer-Rao bound of a diffuse field
score       one calibration through the command line, compared with the truth
"""
