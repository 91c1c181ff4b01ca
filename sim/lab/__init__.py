"""The laboratory: what proves the claims of the pages, reached by ``haptic lab`` and ``haptic bench``."""
