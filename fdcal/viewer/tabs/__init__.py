"""The tabs of the panels, one module each, with what each computes on its threads.

May import: the packages below viewer, and its modules but page and explore; only lessons imports panels, session_view.

curves, scene, view   the tabs of the main panel on the right
map, microphones      the tabs Map and Mics of the panel on the left
lessons               the lessons, which are shown on the canvas
"""
