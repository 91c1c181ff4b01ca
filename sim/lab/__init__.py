"""Studies that check the claims of the pages: ``haptic lab`` and ``haptic bench``."""
