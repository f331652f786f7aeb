"""Algorithm 1 of the SHES paper, and S-ES."""
