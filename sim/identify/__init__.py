"""From a recording to the device behind it: mass, damping, friction, delay and encoder, each with what is known of it."""
