"""Read and calibrate a built probe (commands ``read`` and ``calibrate``): bench, gains, predictions, the virtual probe."""
