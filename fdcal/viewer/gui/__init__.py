"""Panels and controls: what the tabs share.

May import: the packages below viewer, and background and server.

binding      binds controls to a session; what a tick shows; the base of a tab
choices      the choices made on the page
html         status lines, the verdict, remarks and error messages
legend_html  legends and the scale of a map
plots        a plot that is sent as seldom as possible
"""
