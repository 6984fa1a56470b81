"""Whether `plan` and `evaluate` agree: scenes on which `auto` has to decide."""
