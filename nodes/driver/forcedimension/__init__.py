"""Force Dimension omega, delta, sigma and lambda, and the Novint Falcon, through the vendor's DHD."""
