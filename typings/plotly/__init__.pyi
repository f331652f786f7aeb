"""What SHES uses of plotly."""
