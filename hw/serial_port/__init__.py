"""The probe on a serial port (CDC): the same frames, requests as packets."""
