"""The viser server: who may connect, which values are accepted, the error log.

May import: model.

hardening       opens a server that only its own page can use
static_page     the page's title before it has loaded
origin_probe    whether the server refuses a foreign page
connections     a browser's connection: what it may send, how fast, how much it may leave unread
message_checks  checks of messages before viser reads them
client_values   checks of the values that a browser sends
message_buffer  viser's message buffer, made safe for threads
error_log       where errors are written while a page is served
memory          one heap for all threads; what removed controls have left
signals         Ctrl-C and SIGTERM as a flag
"""
