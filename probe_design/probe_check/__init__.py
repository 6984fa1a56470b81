"""Whether a built probe is what was designed, within the workshop's tolerances, and what is off if not."""
