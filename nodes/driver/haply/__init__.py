"""Haply Inverse3, through Haply's Inverse Service."""
