"""Encode and decode the probe's protocol: frames and requests."""
