"""Results and progress on a terminal: tables, progress bars, live numbers, Braille charts."""

# Imports inside functions: rich loads only where a table or a bar is shown.
