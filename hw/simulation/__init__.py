"""Simulate a probe: a model of the firmware, and a virtual probe that runs it behind pyusb."""
