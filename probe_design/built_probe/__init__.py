"""Read and calibrate a built probe (commands ``read`` and ``calibrate``): bench, gains, predictions, the virtual probe."""

# Imports inside functions: tomli_w loads only where a record is written, scipy.optimize where gains are fitted.
