"""What every learning algorithm is to the rest of the package."""
