"""Checks of the stated geometry of a recording against its pictures."""
