"""The 3-D scene: nodes, cameras, the cost map on the floor, picking of microphones.

May import: the packages below viewer, and gui and server.
"""
