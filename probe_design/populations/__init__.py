"""Design files: for which tumours, read how and with which noise a probe is designed, and how many of them it would find."""
