"""The extremes: whatever should break a solver, done to this one."""
