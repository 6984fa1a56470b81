"""Encode and decode the probe's protocol, frames and requests, and read its stream from a device on any bus, with recovery."""
