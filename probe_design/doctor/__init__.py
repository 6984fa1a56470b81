"""Diagnose installation, devices, permissions and a probe's channels, for the command `doctor`."""

# Imports inside functions: usb loads only where devices are looked for: where it fails, that is a finding.
