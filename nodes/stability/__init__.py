"""Stability: exact closed loop, passivity, largest stable stiffness."""
