"""What a probe that is not quite as drawn does to its readings, and which of its numbers must be held how tightly."""
