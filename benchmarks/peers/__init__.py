"""NGSolve and CalculiX beside the levels, in one run."""
