"""Which evaluator at which accuracy, what may be left out, what that changes."""
