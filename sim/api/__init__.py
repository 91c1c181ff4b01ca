"""Functions of ``import haptic``: launch, play, laws, stability and recordings."""
