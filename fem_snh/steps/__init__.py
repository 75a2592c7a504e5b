"""The one driver of steps of load or time: prediction, solution, halving; time integrators.

`stepping` makes the steps and halves those that fail, `step_solver` solves one of them, and
`dynamics` has what a step in time adds: inertia, damping, integrators.
"""
