"""Experiments on scenes: the drop test, the largest stable stiffness, what a scene needs."""
