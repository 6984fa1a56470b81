"""Read the probe on USB: find it, communicate with it, translate its faults."""
