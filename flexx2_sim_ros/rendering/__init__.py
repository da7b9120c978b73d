"""Scenes and their clean depth, rendered with MuJoCo."""
