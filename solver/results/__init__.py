"""Results of evaluators, and the step from film forces to stresses with error bounds."""
