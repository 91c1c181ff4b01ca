"""What is stable, and how stiff it may be: exact closed loop, passivity, largest stable stiffness."""
