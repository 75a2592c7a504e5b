"""The one driver of steps of load or time: prediction, solution, halving; time integrators.

`stepping` makes the steps, solves each and halves those that fail, and
`dynamics` has what a step in time adds: inertia, damping, integrators.
"""
