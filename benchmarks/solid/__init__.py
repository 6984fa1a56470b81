"""The cost of similar scenes one after another in ``solid``."""
