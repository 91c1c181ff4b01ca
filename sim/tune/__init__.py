"""Design a law for an identified device, predict it and verify it on the device."""
