"""Emulators of vendors' libraries and services: an arm with real physics, or with faults."""
