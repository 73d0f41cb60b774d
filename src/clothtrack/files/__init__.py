"""Shared file handling: atomic writes, and the settings that results were made with."""
