"""The viser server: who may connect, what a client may send, and the log.

May import: model.
"""
