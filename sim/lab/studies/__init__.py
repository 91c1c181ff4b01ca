"""Studies that check a claim of this project: ``haptic lab``, and charts and failures of ``haptic study``."""
