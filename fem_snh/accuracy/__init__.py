"""What a result is worth: the errors of goals, with bounds that levels measure.

Goals are scalars of a state (`fem_snh.problem.goals`). Their errors are estimated by a second
solution in a better element on the same cells:

- `effectivity` has the one rule of bounds: what levels say of an error.
- `estimate` adds up the parts of the errors. `lift` chooses the element and solves the problem in
  it, `differences` iterates until the goals are settled, finds what the better element misses;
  `penalties` finds what stiffer penalties change.
- `path_errors` does the same where the end depends on the path: in time, and with friction.
- `indicators` distributes an error to the cells, by dual solutions; `refinement` finds the volumes
  of the next mesh's cells from them.
- `goal_errors` has the result, with its bounds, as it is printed and recorded.

`levels` decides on the levels of a run to a required accuracy.
"""
