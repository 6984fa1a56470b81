"""Record the origin of numbers: versions, digests and the command, in every file and JSON object that the toolkit writes."""

# Imports inside functions: importlib.metadata loads only where a block with versions is made.
