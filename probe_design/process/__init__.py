"""The program as a process of the system: the signals that end it, and what the system allows it."""
