"""What must not break: materials, solves and solvers at their extremes."""
