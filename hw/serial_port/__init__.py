"""Read the probe on a serial port (CDC): the same frames as on USB, with requests as packets."""
