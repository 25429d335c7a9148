"""The page: a picture drawn by viser, controls that become commands of a session.

May import: every package below it, from model to graphics.

app       serve(): opens the server and the page
page      what stays while sessions come and go, and the main loop; `Page.open(opening)` shows something else
switch    prepares the next session while the present one goes on; preparing does the work
viewing   one session on the screen
frame     the panels and their tabs
binding      the choices made on the page
controls  buttons and sliders, every value bounded before it is used
stage     a Picture's primitives as viser's scene nodes
plots     error and cost curves
words     status, legend and colour bar as HTML
safety    who may connect, and what a client may say
"""

from ..session.request import OpenRequest
from .app import serve

__all__ = ["OpenRequest", "serve"]
