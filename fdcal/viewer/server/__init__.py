"""The server of the page: who may connect, which values are accepted, what is logged.

May import: the packages below viewer.

hardening      a server that only its own page can use, and repairs of viser
connections    one client's connection, with a bounded rate
client_values  checks of messages and of the values in them
process        signals, the error log, and the memory of the process
"""
