"""Procedures that come with the bench: one script each, also examples of how to write one."""
