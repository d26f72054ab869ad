"""Rods: kinematics from curvatures, dynamics, the linearly implicit step."""
