"""How fast the package is, beside the physics alone."""
