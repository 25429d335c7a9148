"""The tabs of the panels, one module each, with what each computes on its threads.

May import: the packages below viewer, and the modules of viewer but page, panels, session_view and explore.

curves, scene, view                      the main panel on the right; lessons stand on the canvas
map                                      the tab Map of the panel on the left
microphones                              the other tab there
"""
