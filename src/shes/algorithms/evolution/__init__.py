"""Evolution strategies: SHES, S-ES and the primitive alone."""
