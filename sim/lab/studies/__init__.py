"""Studies that check this project's claims: ``haptic lab``, and some of ``haptic study``."""
