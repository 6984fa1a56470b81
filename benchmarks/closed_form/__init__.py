"""The closed form's accuracy, speed and stated errors."""
