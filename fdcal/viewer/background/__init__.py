"""Work on background threads that several tabs share. What a single tab computes stands in its module.

May import: the packages below viewer, and gui.

prepare    from a request to a session that can be shown, and the threads of a session
cost_maps  the map on the floor or in space
"""
