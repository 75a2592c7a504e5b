"""What a result is worth: estimated errors of goals; locking, inversion, and notes.

Goals are scalars of a state (`goals`). Their errors are estimated by a second solution in a better
element on the same cells:

- `estimate` adds up the parts of the errors. `lift` chooses the element and solves the problem in
  it, `differences` iterates until the goals are settled, finds what the better element misses, and
  what penalties and Newton's tolerance change.
- `path_errors` does the same where the end depends on the path: in time, and with friction.
- `indicators` distributes an error to the cells, by the dual solutions of `duals`.
- `goal_errors` has the result, as it is printed and recorded.

`goal_bounds` and `levels` decide on the meshes of a run to an accuracy. `state_notes` finds what is
wrong with a state that has converged.
"""
