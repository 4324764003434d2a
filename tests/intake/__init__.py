"""Folders of recordings that become studies."""
