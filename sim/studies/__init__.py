"""Studies: functions of typed options that return what they found; ``haptic study`` and ``haptic.study`` call them."""
