"""Work on background threads: preparation, cost maps, uncertainty, exports.

May import: the packages below viewer, and gui.
"""
