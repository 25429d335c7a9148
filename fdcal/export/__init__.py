"""What is taken away from a run: for other programs, for a lecture without a server, for going on another day.

replay     the whole run as one HTML file that needs no network
paraview   maps as .vti, microphones as .vtp
positions  the microphones as a table
sessionfile, states  a session to be opened where it was left
"""
