"""What ``import haptic`` offers: launch, play, laws, stability, recordings, in the words that a notebook needs."""
