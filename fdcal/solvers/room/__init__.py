"""The solver of rooms of known size: absolute positions, up to the symmetries of the room.

May import: model, acoustics and cost.
"""
