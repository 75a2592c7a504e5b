"""The motion of a body in time: steps, prescribed motion, and what a motion conserves."""
