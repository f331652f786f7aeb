"""Hierarchy: goals, intrinsic rewards, agents, and the loop over environment steps."""
