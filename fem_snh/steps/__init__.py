"""The driver of load and time steps: prediction, solution, halving; time integrators.

`stepping` solves each step and halves steps that fail; `dynamics` adds inertia, damping and
integrators.
"""
