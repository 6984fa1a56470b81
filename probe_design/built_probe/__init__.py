"""``read``, ``calibrate``, ``check``: bench, gains, predictions, deviations, the virtual probe."""
