"""The page: a picture drawn by viser, and controls whose callbacks give commands to a session.

May import: every package below it, from model to graphics.

app              serve(): opens the server and the page
page             the parts that outlive a session, the main loop, and the view in the page's address
session_view     one session on the screen, and its picture
panels           the run bar, the keys and the tabs of one session
state            what the page shows, the choices of its users, and the controls that change them
html             the texts of the page
tabs             one module for each tab
explore          the layout Explore, and the files that a user uploads
prepare          from a request to a session that can be shown
cost_maps        the map on the floor or in space, computed on threads
scene3d          the scene: nodes and cameras
opening          the film with which the page begins
drop             microphones selected and dragged in the scene, and how they roll downhill
server           who may connect, which values are accepted, the error log
"""

from ..session.sources import OpenRequest
from .app import serve

__all__ = ["OpenRequest", "serve"]
