"""Studies: functions of typed options, called by ``haptic study`` and ``haptic.study``."""
