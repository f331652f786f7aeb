"""Hierarchy: goals, primitive rewards, the two-level agent, and the loop over environment steps."""
