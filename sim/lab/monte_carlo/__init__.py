"""Random devices inside and outside the identified model class, and their identification."""
