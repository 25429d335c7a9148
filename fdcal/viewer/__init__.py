"""The page: a picture drawn by viser, controls that become a session's commands.

app       serve(): opens the server, prepares the session, copies the newest state to the screen
controls  buttons and sliders, every value bounded before it is used
stage     a Picture's primitives as viser's scene nodes
plots     error and cost curves
words     status, legend and colour bar as HTML
safety    who may connect, and what a client may say
"""

from .app import serve

__all__ = ["serve"]
