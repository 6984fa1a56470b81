"""The program as a process: signals that end it, and limits of the system."""
