"""The evaluator ``contact`` compared with other codes, and the references that these codes give."""
