"""Moving bodies: a MuJoCo scene and its tool, which the coupling connects to the device."""
