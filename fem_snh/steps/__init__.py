"""Steps of load or time: prediction, solution, halving of a step that fails."""
