"""Panels and controls: what the tabs share.

May import: the packages below viewer, and server.

binding   the choices made on the page, what a tick shows, and the controls bound to a session
html      status lines, the verdict, legends, error messages, and the regions on the canvas
plots     a plot that is sent as seldom as possible
"""
