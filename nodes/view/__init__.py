"""The page: a scene that moves, plots, sliders, a map of stability and a hand to drag, in any browser on this machine."""
