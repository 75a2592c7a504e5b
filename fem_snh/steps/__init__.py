"""The one driver: steps of load or time, their prediction, solution and halving.

`stepping` makes the steps and halves those that fail, `step_solver` solves one of them, and
`dynamics` has what a step in time adds: inertia, damping, integrators.
"""
