"""Studies: sweeps and fits.

A sweep is many runs of a scene in processes of their own, collected in one table.
"""
