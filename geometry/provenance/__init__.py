"""Record the origin of numbers: versions, digests and the command, in every file and JSON object that the toolkit writes."""
