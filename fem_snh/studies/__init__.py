"""Studies: many runs of scenes in processes of their own, collected in one table.

The commands ``sweep``, ``tradeoff`` and ``extremes`` call them; `batch` is what they share.
"""
