"""The 3-D scene: nodes and cameras.

May import: the packages below viewer, and gui and server.
"""
