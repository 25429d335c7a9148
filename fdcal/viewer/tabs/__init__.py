"""The tabs of the panels, one module each.

May import: the packages below viewer, and gui, scene3d and background.
"""
