"""Sound fields and their simulation: dictionaries, finite differences, closed forms, spectra.

May import: model.
"""
