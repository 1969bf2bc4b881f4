"""Finds results of earlier runs in a folder, shows their trends, and deletes them safely."""
