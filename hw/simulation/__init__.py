"""A model of the firmware and the virtual probe that runs it behind pyusb."""
