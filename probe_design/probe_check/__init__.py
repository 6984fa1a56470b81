"""Check whether a built probe is as designed, within the workshop's tolerances, and find what differs if not."""
