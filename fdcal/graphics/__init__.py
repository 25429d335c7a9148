"""Pictures without a browser: primitives, composition, off-screen drawing, replay, ParaView.

May import: every package below it, from model to session.
"""
