"""Panels and controls: what the tabs share.

May import: the packages below viewer, and background and server.

layout       the two panels, their tabs, and the folders of one session in them
binding      binds controls to a session
choices      the choices made on the page
html         status lines, the verdict, remarks and error messages
legend_html  legends and the scale of a map
plots        a plot that is sent as seldom as possible
"""
