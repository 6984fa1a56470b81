"""`doctor`: what is installed, found and permitted, and whether a probe's channels are sound."""
