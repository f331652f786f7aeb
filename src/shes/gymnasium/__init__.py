"""The environments as single and vector Gymnasium environments."""
