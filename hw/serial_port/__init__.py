"""Read the probe on a serial port (CDC): the same frames as on USB, with requests as packets."""

# Imports inside functions: serial loads only where a port is opened: without it the others still work.
