"""Results and progress on a terminal: tables, progress bars, live numbers, Braille charts."""
