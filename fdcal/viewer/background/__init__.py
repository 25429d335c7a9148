"""Work on background threads: preparation, cost maps, sweeps, the verdict, races.

May import: the packages below viewer, and gui. What a single tab computes stands in its module.

threads      the threads of one session, and a computation on one of them
"""
