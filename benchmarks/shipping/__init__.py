"""What a user installs: the wheel in an environment that holds nothing else, its size and its time."""
