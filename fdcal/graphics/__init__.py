"""Pictures without a browser: primitives, composition, off-screen drawing, replay.

May import: the packages from model to session.
"""
