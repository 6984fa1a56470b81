"""NGSolve and CalculiX compared with the evaluators, in one run."""
