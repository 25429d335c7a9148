"""Constants that all simulations of the cases share."""

SOUND_SPEED = 343.0  # m/s
