"""Robots: kinematics, and configurations in collision."""
