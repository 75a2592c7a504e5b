"""Studies: many runs of scenes in processes of their own, collected in one table.

The command ``sweep`` calls them.
"""
