"""Diagnose installation, devices, permissions and a probe's channels, for the command `doctor`."""
