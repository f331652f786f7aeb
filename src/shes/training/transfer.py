"""`make_config` finds here what it takes from the transfer of levels, until it moves to `shes.runs` itself."""

from shes.runs.transfer import brought_settings, transferred_levels

__all__ = ["brought_settings", "transferred_levels"]
