"""Things that move: a scene in MJCF, and the tool in it that the coupling holds to the device."""
