"""Pictures without a browser: primitives, composition, off-screen drawing, replay, ParaView.

May import: the packages from model to recordings.
"""
