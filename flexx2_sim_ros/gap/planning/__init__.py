"""Scenes that can be recorded to learn more about a camera."""
