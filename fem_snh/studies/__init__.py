"""Studies: many runs of scenes in processes of their own, collected in one table.

The commands ``sweep`` and ``tradeoff`` call them; `batch` is what they share.
"""
