"""Finds results of earlier runs in a folder, follows them over time, deletes them with care."""
