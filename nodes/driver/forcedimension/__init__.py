"""Force Dimension devices and the Novint Falcon, through the vendor's DHD."""
