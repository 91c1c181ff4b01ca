"""3D Systems Touch and Touch X through OpenHaptics."""
