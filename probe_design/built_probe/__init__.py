"""``read`` and ``calibrate``: bench, gains, predictions, the virtual probe."""
