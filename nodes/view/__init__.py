"""The page: live scene, plots, sliders, stability map and a hand to drag, in a browser."""
