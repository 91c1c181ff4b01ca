"""Identify a device from a recording: mass, damping, friction, delay and encoder step."""
