"""The page: a picture drawn by viser, and controls whose callbacks give commands to a session.

May import: every package below it, from model to graphics.

app              serve(): opens the server and the page
page             what stays while sessions come and go, and the main loop
preview          what the page shows while the first session is prepared
session_view     one session on the screen, and its picture
panels           the run bar and the tabs of one session
lesson_settings  applies what a lesson's step sets, and brings back what the page showed before
gui              controls and texts that tabs share
tabs             one module for each tab
background       work on background threads that several tabs share
scene3d          the scene: nodes, cameras, picking
server           who may connect, which values are accepted, the error log
"""

from ..session.sources import OpenRequest
from .app import serve

__all__ = ["OpenRequest", "serve"]
