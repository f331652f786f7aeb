"""Agents with any number of levels: networks, goals, rewards, outputs, views."""
