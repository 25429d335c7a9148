"""Panels and controls: what the tabs share.

May import: the packages below viewer.
"""
