"""The probe on USB: finding it, talking to it, naming what goes wrong."""
