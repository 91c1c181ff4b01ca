"""Devices drawn at random, inside the class that identification assumes and outside it, and what identifying them comes to."""
