"""How results and progress look on a terminal: tables, bars, live numbers, Braille charts."""
