"""Read and calibrate a built probe (commands ``read`` and ``calibrate``): bench, gains, predictions, the virtual probe."""

# Imports inside functions: tomli_w loads only to write a record, scipy.optimize to fit gains, contact to predict by it.
