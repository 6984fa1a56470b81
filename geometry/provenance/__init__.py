"""Where numbers come from: one block of versions, digests and the command, in every file and object that the toolkit makes."""
