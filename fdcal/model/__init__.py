"""What a run is: the scene, the array, the measurement and their files.

May import: no other package of fdcal.
"""
