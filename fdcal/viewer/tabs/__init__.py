"""The tabs of the panels, one module each.

May import: the packages below viewer, and gui, scene3d, background and server.

solver, scene, map, view, export, lessons, help     tabs of the main panel on the right
curves, maps, modes, microphones, comparison, record  tabs of the panel on the left
"""
